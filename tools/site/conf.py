"""Sphinx' settings for the site that `make docs` builds from docs/.

Sphinx, because the docstrings are its markup already (autodoc reads them with their types), its
search works from a folder without a server, and a broken notebook, link or reference is a warning,
which `make docs` turns into a failure. Furo has no fonts or scripts of other hosts, and a dark
theme.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import bundle  # noqa: E402

project = "bundle"
author = "the authors of bundle"
copyright = "the authors of bundle, BSD-3-Clause"
version = release = bundle.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "tools.site.repository_files",
    "tools.site.derivations",
    "tools.site.mathml",
    "tools.site.options_reference",
    "tools.site.public_names",
]
exclude_patterns = ["**.ipynb_checkpoints"]

# Anchors of headings as GitHub makes them, for links such as align.md#gcp_listtxt.
myst_heading_anchors = 4
myst_enable_extensions = ["deflist", "dollarmath"]
html_math_renderer = "mathml"  # no script and no font of another host

# Notebooks are kept without outputs: what a page shows was computed while the site was built.
# Kernels take no settings of the user's, and warn of nothing that is not ours.
PROFILE = ROOT / "build" / "ipython" / "profile_default"
PROFILE.mkdir(parents=True, exist_ok=True)
(PROFILE / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 'ERROR'\n")
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # small matrices: threads would wait for each other
os.environ["IPYTHONDIR"] = str(PROFILE.parent)
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 60
# This notebook needs an extra; without it, its page has the code only.
if importlib.util.find_spec("torch") is None:
    nb_execution_excludepatterns = ["tutorials/learned_sigmas.ipynb"]
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("ArrayLike",)}
maximum_signature_line_length = 80
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(?!bundle\.\w+$).*")
]  # types of others, names inside of modules
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

smartquotes = False  # quotes are code more often than speech

html_theme = "furo"
html_title = f"bundle {version}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
pygments_style = "default"
pygments_dark_style = "github-dark"
