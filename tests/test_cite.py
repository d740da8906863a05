"""`acoustube cite`: its references are those of the docstrings, and those that a result used."""

import json
import re
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
import xarray as xr

import acoustube
from acoustube.cli import main
from acoustube.cli.cite import topics_of
from acoustube.cli.references import REFERENCES, TOPICS, references

PACKAGE = Path(acoustube.__file__).parent
DOI = re.compile(r"doi:(10\.\S+?)[.,)]?\s")


def docstring_dois():
    """The DOIs in all modules but those of this command."""
    modules = [path for path in PACKAGE.rglob("*.py") if path.name != "references.py"]
    return {doi for path in modules for doi in DOI.findall(path.read_text(encoding="utf-8"))}


AUTHOR_AND_YEAR = re.compile(r"(?:^|\])\s*([A-Z][\w\-]+), [A-Z]\.[^()]{0,160}?\((\d{4})\)", re.M)


def docstring_authors():
    """First authors and years of the references in all modules but those of this command."""
    modules = [path for path in PACKAGE.rglob("*.py") if path.name != "references.py"]
    return {
        found
        for path in modules
        for found in AUTHOR_AND_YEAR.findall(path.read_text(encoding="utf-8"))
    }


def written(folder, settings, title="A press"):
    folder.mkdir()
    with h5py.File(folder / "run.nc", "w") as file:
        file.attrs.update({"title": title, "configuration": json.dumps(settings)})
    return folder


def settings(depth=4.0, surface=None, **waves):
    found = {"indentation": {"depth_mm": depth},
             "tube": {"inner_diameter_mm": 7.9, "surface": surface}}  # fmt: skip
    return found | ({"waves": waves} if waves else {})


def test_authors_in_docstrings_are_cited():
    listed = {(r.author.split(",")[0], r.fields.get("year")) for r in REFERENCES}
    assert len(docstring_authors()) > 9
    assert docstring_authors() <= listed


def test_dois_are_those_of_the_docstrings():
    assert {r.fields["doi"] for r in REFERENCES if "doi" in r.fields} == docstring_dois()


def test_keys_differ_and_topics_are_known_and_in_order():
    assert len({reference.key for reference in REFERENCES}) == len(REFERENCES)
    topics = [reference.topic for reference in REFERENCES]
    assert sorted(topics, key=list(TOPICS).index) == topics
    assert set(topics) == set(TOPICS)


def test_text_names_every_reference_under_its_use(capsys):
    assert main(["cite"]) == 0
    text = capsys.readouterr().out
    for reference in REFERENCES:
        assert reference.in_words() in text
    assert "Flory, P. J., Thermodynamic relations" in text
    assert "vol. 57, 829-838, 1961, doi:10.1039/TF9615700829" in text
    assert text.index("the press:") < text.index("losses at the wall and in the air:")


def test_bibtex_has_an_entry_for_each_with_balanced_braces(capsys):
    assert main(["cite", "--bibtex"]) == 0
    entries = capsys.readouterr().out.strip().split("\n\n")
    assert [re.match(r"@\w+\{(\w+),", entry)[1] for entry in entries] == [r.key for r in REFERENCES]
    for entry in entries:
        assert entry.count("{") == entry.count("}")
        assert entry.endswith("\n}")
        assert re.search(r"^  title = \{.+\},$", entry, re.MULTILINE)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (settings(), {"press"}),
        (settings(depth=6.0), {"press", "folds"}),
        (settings(surface="a.stl"), {"press", "surface"}),
        (settings(losses="off", method="full"), {"press", "air", "absorber", "grid"}),
        (
            settings(losses="on", method="scattering"),
            {"press", "air", "absorber", "grid", "losses", "scattering", "cascade"},
        ),
    ],
)
def test_run_cites_what_its_settings_used(given, expected, tmp_path, capsys):
    folder = written(tmp_path / "run", given)
    assert topics_of(folder) == expected
    assert main(["cite", str(folder)]) == 0
    text = capsys.readouterr().out
    used = references(expected)
    for reference in REFERENCES:
        assert (reference.in_words() in text) == (reference in used)


@pytest.mark.parametrize(
    ("losses", "solver", "expected"),
    [
        ("none", "time domain", {"air", "absorber", "grid", "scattering"}),
        ("wall and air", "time domain", {"air", "absorber", "grid", "scattering", "losses"}),
        ("wall and air", "spectral", {"air", "scattering", "losses"}),
    ],
)
def test_scattering_cites_its_losses_and_its_solver(losses, solver, expected, tmp_path):
    origin = {"title": "Scattering of duct modes by a lumen", "losses": losses, "solver": solver}
    with h5py.File(tmp_path / "s.nc", "w") as file:
        file.attrs.update(origin)
    assert topics_of(tmp_path / "s.nc") == expected


@pytest.mark.parametrize(("first", "expected"), [("markers: a.csv", {"arm"}), ("arm", set())])
def test_sleeve_cites_the_fit_where_there_were_markers(first, expected, tmp_path):
    (tmp_path / "layout.txt").write_text(first)
    (tmp_path / "sleeve.csv").touch()
    assert topics_of(tmp_path) == expected


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("none", "none does not exist"),
        (".", ". is not a result of acoustube"),
        ("a.nc", "cannot be read"),
    ],
)
def test_what_is_no_result_is_refused(name, part, tmp_path, capsys):
    (tmp_path / "a.nc").write_text("no file")
    assert main(["cite", name]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert part in line


@pytest.mark.parametrize("attributes", [{}, {"configuration": "{}"}, {"configuration": "[1]"}])
@pytest.mark.parametrize("name", ["run.nc", "cases-1.nc"])
def test_file_of_another_program_with_a_name_of_ours_is_refused(name, attributes, tmp_path, capsys):
    xr.Dataset({"x": ("press", [1.0])}, attrs=attributes).to_netcdf(
        tmp_path / name, engine="h5netcdf"
    )
    assert main(["cite", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert name in line


def test_file_with_the_title_of_a_scattering_alone_is_refused(tmp_path, capsys):
    path = tmp_path / "s.nc"
    xr.Dataset(attrs={"title": "Scattering of light"}).to_netcdf(path, engine="h5netcdf")
    assert main(["cite", str(path)]) == 2
    assert "s.nc" in capsys.readouterr().err


def test_program_is_cited_as_the_citation_file_says():
    path = Path(__file__).parents[1] / "CITATION.cff"
    if not path.is_file():
        pytest.skip("tests run apart from the checkout")
    text = path.read_text(encoding="utf-8")
    (program,) = [reference for reference in REFERENCES if reference.topic == "software"]
    assert f'title: "{program.title.strip("{}")}"' in text
    assert f"version: {program.fields['version']}" in text


def test_closed_pipe_of_a_reader_is_no_error():
    command = "import sys; from acoustube.cli._app import main; sys.exit(main(['cite']))"
    with subprocess.Popen(
        [sys.executable, "-c", command], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
