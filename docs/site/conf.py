"""Settings of Sphinx; `docs/site/build.py` runs it."""

from typing import Any

project = "ahrs_sim"
author = project_copyright = "the ahrs_sim authors"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
exclude_patterns = ["_build"]

html_extra_path = ["extra"]
html_theme = "furo"
html_title = "ahrs_sim"
html_theme_options = {"light_css_variables": {"code-font-size": "75%"}}  # lines of 100 characters fit
html_copy_source = False
html_show_sphinx = False
default_role = "code"  # single backticks of docstrings

myst_heading_anchors = 3

nb_execution_mode = "force"
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_use_ivar = True
suppress_warnings = ["misc.highlighting_failure"]


def _examples(_: Any, what: str, *rest: Any) -> None:
    """Take indented blocks of a module's docstring for code, as a reader of the source does."""
    lines: list[str] = rest[-1]
    if what == "module":
        marked: list[str] = []
        for line in lines:
            before = next((x for x in reversed(marked) if x), "")
            if line.startswith("    ") and marked and not marked[-1] and not before.startswith("    "):
                marked += ["::", ""]
            marked.append(line)
        lines[:] = marked


def setup(app: Any) -> None:
    """Register what is above."""
    app.connect("autodoc-process-docstring", _examples)
