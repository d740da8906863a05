"""Sphinx settings."""

import os
import pkgutil
import shutil
from collections import defaultdict
from functools import cached_property
from pathlib import Path

import pyvista
from numpydoc import docscrape_sphinx
from sphinx.domains.python import PythonDomain
from sphinx_gallery.sorting import ExplicitOrder

import acoustube

GALLERY = os.environ.get("GALLERY", "all")
"""Scripts that are run: ``all``, which takes minutes; ``short``, the robot's alone; or ``no``."""
if GALLERY not in ("all", "short", "no"):
    raise SystemExit(f"GALLERY = {GALLERY} is not known; use all, short or no")
os.environ.setdefault("MPLBACKEND", "agg")
pyvista.OFF_SCREEN = pyvista.BUILDING_GALLERY = True

project = "acoustube"
author = "acoustube developers"
copyright = f"2026, {author}"
release = acoustube.__version__

extensions = [
    "myst_parser", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.mathjax",
    "sphinx_gallery.gen_gallery",
]  # fmt: skip
if GALLERY == "all":
    extensions.append("sphinx.ext.viewcode")  # as many pages again, of sources
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "verification/*.rst"]
autodoc_default_options = {
    "members": True,
    "member-order": "bysource",
    # scikit-learn adds these to every estimator, with links into its own documentation.
    "exclude-members": "set_fit_request, set_predict_request, set_score_request",
}
# The settings of a section are its attributes, documented by `configuration.md`.
numpydoc_show_class_members = False

# Examples begin with the stage that they are about.
STAGES = (
    "chain", "indentation", "waves", "ranging", "signals", "estimation", "inversion", "sleeve",
    "sweep", "sensor",
)  # fmt: skip


def in_order_of_stages(folder):
    """Return the names of the examples in the order of the data, and of the alphabet."""
    names = sorted(path.name for path in folder.glob("*.py"))
    return [name for stage in STAGES for name in names if name.startswith(f"{stage}_")]


EXAMPLES = in_order_of_stages(Path(__file__).parents[1] / "examples")

# The examples, and the figures that compare with known results, are run as the pages are built.
sphinx_gallery_conf = {
    "examples_dirs": ["../examples", "verification"],
    "gallery_dirs": ["_generated/gallery", "_generated/verification"],
    "filename_pattern": "/sensor_what_does_a_robot_feel" if GALLERY == "short" else "/",
    "ignore_pattern": "forearm_markers",
    "within_subsection_order": ExplicitOrder([*EXAMPLES, "*"]),
    "image_scrapers": ("matplotlib", pyvista.Scraper()),
    "matplotlib_animations": GALLERY == "all",  # drawing one takes longer than its script
    "abort_on_example_error": True,
    "show_memory": False,
    "write_computation_times": False,
    "download_all_examples": False,
    "plot_gallery": GALLERY != "no",
}
# Packages hand on names of their modules: a short name may have two targets, and either will do.
suppress_warnings = ["ref.python"]
if GALLERY != "all":
    suppress_warnings.append("image.not_readable")  # tests/test_links.py knows the pictures' names
# Pages of others are looked at with -D linkcheck_ignore= where there is a network.
linkcheck_ignore = [r"https?://"]

# furo writes the table of contents of all pages into each, which takes longer than the pages do.
html_theme = "furo" if GALLERY == "all" else "basic"
html_title = f"acoustube {release}"

# The storeys from the stages up, in the order of the data; what is not named here comes last.
ORDER = (
    "tube", "air", "indentation", "lumen", "waves", "ranging", "recordings", "signals",
    "estimation", "inversion", "sleeve", "runs", "sensor", "reports", "cli", "base",
)  # fmt: skip


def place(name):
    """Return the sorting key of a module's name."""
    first = name.split(".")[1]
    return (ORDER.index(first) if first in ORDER else len(ORDER), name)


def write_reference(folder):
    """Write one page per module."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    found = (module.name for module in pkgutil.walk_packages(acoustube.__path__, "acoustube."))
    names = sorted((name for name in found if "._" not in name), key=place)
    for name in names:
        page = f"{name}\n{'=' * len(name)}\n\n.. automodule:: {name}\n"
        (folder / f"{name}.rst").write_text(page, encoding="utf-8")
    entries = "\n".join(f"   {name}" for name in names)
    index = (
        "Reference\n=========\n\n"
        "The modules in the order of the data: each takes what the one before it returns.\n\n"
        f".. toctree::\n   :maxdepth: 1\n\n{entries}\n"
    )
    (folder / "index.rst").write_text(index, encoding="utf-8")


write_reference(Path(__file__).parent / "_generated" / "reference")


class IndexedPythonDomain(PythonDomain):
    """Python's objects, found by the last part of their names.

    Sphinx compares each reference with all of them, a fifth of the build.
    """

    @cached_property
    def by_last_part(self):
        """Objects by the last part of their names, all of them: references are resolved last."""
        found = defaultdict(dict)
        for name, entry in self.objects.items():
            found[name.rpartition(".")[2]][name] = entry
        return found

    def find_obj(self, env, modname, classname, name, *how):
        """Return the names and entries that a reference may mean; see the base class."""
        everything = self.data["objects"]
        last = name.removesuffix("()").rpartition(".")[2]
        self.data["objects"] = self.by_last_part.get(last, {})
        try:
            return super().find_obj(env, modname, classname, name, *how)
        finally:
            self.data["objects"] = everything


def keep_first_result(function):
    """Return a function that is called once, and returns that result again for all like calls."""
    results = []

    def kept(*args, **kwargs):
        results.extend([] if results else [function(*args, **kwargs)])
        return results[0]

    return kept


# numpydoc compiles its one template anew for each of 12,000 docstrings, a sixth of the build.
docscrape_sphinx.SandboxedEnvironment = keep_first_result(docscrape_sphinx.SandboxedEnvironment)


def leave_out_search(app):
    """Make no index of words, which takes a tenth of a short build."""
    app.builder.search = False


def setup(app):
    """Give Sphinx the domain with an index."""
    app.add_domain(IndexedPythonDomain, override=True)
    if GALLERY != "all":
        app.connect("builder-inited", leave_out_search)
