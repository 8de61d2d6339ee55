"""Settings of the documentation. ``make docs`` builds it, without network."""

import os
import sys
from pathlib import Path

from sugiyama_ros import __version__

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
# notebooks call the commands of this environment
os.environ["PATH"] = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))

project = "sugiyama_ros"
author = "sugiyama_ros contributors"
project_copyright = f"2026, {author}"
release = version = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "reference", "effect_pages"]
exclude_patterns = ["_build", "_ext"]
nitpicky = True

autodoc_typehints = "none"  # numpydoc's sections say the types
autosummary_generate = False
numpydoc_show_class_members = False

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parent / "_build" / "notebooks")
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_output_stderr = "remove"  # bars of progress

html_theme = "pydata_sphinx_theme"
html_title = "sugiyama_ros"
html_show_sourcelink = False
html_sidebars: dict[str, list[str]] = {"**": []}
html_theme_options = {
    "logo": {"text": "sugiyama_ros"},
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
}
