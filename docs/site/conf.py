"""Settings of Sphinx; `docs/site/build.py` runs it."""

project = "ahrs_sim"
author = "The ahrs_sim authors"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = "ahrs_sim"
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
