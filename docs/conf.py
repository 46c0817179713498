"""Sphinx with MyST-NB: every page with code cells is executed when the documentation is built."""

from __future__ import annotations

from trueplant import __version__

project = "trueplant"
author = "The trueplant authors"
copyright = "The trueplant authors"
version = release = __version__
language = "en"

extensions = ["myst_nb"]
exclude_patterns = ["_build", "jupyter_execute"]
myst_heading_anchors = 3
myst_enable_extensions = ["deflist"]

# Always executed afresh, in an empty folder: an example that no longer runs stops the build.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_mime_priority_overrides = [("html", "text/html", 0), ("html", "image/svg+xml", 10), ("html", "image/png", 20)]

html_theme = "alabaster"
html_static_path = ["_static"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "description": "What changed in the plant, how surely, and the updated model.",
    "fixed_sidebar": True,
    "page_width": "1200px",
    "body_max_width": "920px",
    "sidebar_width": "230px",
    "show_powered_by": False,
    "font_family": "system-ui, 'Segoe UI', 'Liberation Sans', Arial, sans-serif",
    "head_font_family": "system-ui, 'Segoe UI', 'Liberation Sans', Arial, sans-serif",
    "font_size": "16px",
    "code_font_size": "0.85em",
}
