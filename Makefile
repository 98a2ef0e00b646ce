# Two commands are all one needs: `make fly` and `make test`. Both set up .venv first and rerun in seconds.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SCENARIO ?= circuit

.PHONY: fly test test-fast lint docs bench clean

fly: $(VENV)/.installed
	$(BIN)/ahrs-sim fly $(SCENARIO) --force

test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n auto --dist loadfile

test-fast: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n auto --dist loadfile -m "not long"

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.installed-docs
	$(BIN)/python docs/site/build.py

bench: $(VENV)/.installed-test
	set -e; for script in benchmarks/*_speed.py; do echo "== $$script"; $(BIN)/python $$script; done

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.installed-test: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache
