"""The command `acoustube sleeve`: its files, output and refusals."""

import csv
import subprocess
from pathlib import Path

import numpy as np
import pytest

from acoustube.base.errors import ConfigError
from acoustube.cli import _app
from acoustube.reports.scenes import sleeve as sleeve_scene
from acoustube.reports.sleeve_table import contact_in_words
from acoustube.sleeve import design, fit_arm, layout, read_markers, wound

MARKERS = Path(__file__).parents[1] / "examples" / "forearm_markers.csv"
FOREARM = ["--forearm", "25", "17", "26"]


@pytest.fixture
def undrawn(monkeypatch):
    """A machine on which VTK ends its process."""

    def dies(command, **_):
        raise subprocess.CalledProcessError(-11, command)

    monkeypatch.setattr(sleeve_scene.subprocess, "run", dies)


@pytest.mark.slow
def test_markers_become_a_table_figures_in_words_and_a_picture(tmp_path, capsys):
    words = ["sleeve", str(MARKERS), "--loops", "9", "--distance", "80", "2:140"]
    assert _app.main([*words, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    for part in (
        "1 left out as outliers", "1 gap", "9 loops each", "contact at 80 cm on tube 1",
        "contact at 140 cm on tube 2", "the next loop, of tube 2",
    ):  # fmt: skip
        assert part in said
    assert (tmp_path / "out" / "layout.txt").read_text() in said
    # A picture is drawn where VTK can, and where it cannot the command says so.
    drawn = (tmp_path / "out" / "figure.png").is_file()
    assert drawn != ("VTK cannot draw" in said)
    markers = read_markers(MARKERS)
    tubes = wound(fit_arm(markers.first, markers.second), 9)
    with (tmp_path / "out" / "sleeve.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows[5], rows[-2]:
        place = 1e3 * tubes[int(row["tube"]) - 1].place(1e-2 * float(row["distance_cm"]))
        assert [float(row[f"{axis}_mm"]) for axis in "xyz"] == pytest.approx(place, abs=0.3)
    assert {row["loop"] for row in rows} == {str(n) for n in range(1, 10)}


@pytest.mark.usefixtures("undrawn")
def test_sleeve_is_written_where_nothing_can_be_drawn(tmp_path, capsys):
    words = ["sleeve", *FOREARM, "--pitch", "4", "--tubes", "1", "--lead", "5"]
    assert _app.main([*words, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "VTK cannot draw on this machine" in said
    assert "its first 10 cm on the arm are in the dead zone" in said
    with (tmp_path / "out" / "sleeve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["heard"] for row in rows[:12]] == ["0"] * 10 + ["1"] * 2
    assert not (tmp_path / "out" / "figure.png").exists()


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ([*FOREARM, "--loops", "0"], ["loops = 0", "0.25 to 100"]),
        (FOREARM, ["--loops 9", "--pitch"]),
        (["--loops", "9"], ["a file of markers, or --forearm"]),
        ([*FOREARM, "--loops", "12"], ["a tube of", "up to 250 cm", "or fewer"]),
        ([*FOREARM, "--loops", "9", "--distance", "0.8"], ["distance = 0.8 cm", "15 to 241"]),
        ([*FOREARM, "--loops", "9", "--distance", "3:80"], ["3:80", "use 1 to 2"]),
        ([*FOREARM, "--loops", "9", "--distance", "near"], ["near is not a distance", "2:80"]),
        ([*FOREARM, "--loops", "9", "--tubes", "1.5"], ["tubes = 1.5 is not a whole number"]),
        (["--forearm", "250", "17", "26", "--loops", "9"], ["length of the forearm = 250"]),
        (["none.csv", "--loops", "9"], ["none.csv is not a file"]),
        ([str(MARKERS), "--loops", "9", "--unit", "m"], ["mm read as m"]),
        ([str(MARKERS), "--loops", "9", "--columns", "A", "C"], ["no column C; it has A, B"]),
    ],
)
def test_sleeves_that_cannot_be_are_refused_in_a_line(words, parts, tmp_path, capsys):
    assert _app.main(["sleeve", *words, "--out", str(tmp_path / "out")]) == 2
    printed, said = capsys.readouterr()
    assert printed == ""
    assert said.count("\n") == 1
    for part in parts:
        assert part in said
    assert not (tmp_path / "out").exists()


def test_advised_distances_and_the_end_of_a_tube_have_their_loop():
    tubes = design(0.25, (0.17, 0.26), loops=9)
    found = layout(tubes)
    with pytest.raises(ConfigError, match="use 15 to ") as refusal:
        contact_in_words(tubes, found, (1, 9.0))
    farthest = float(str(refusal.value).split()[-2])
    assert farthest == pytest.approx(100 * tubes[1].tube_length, abs=0.01)
    for distance in (15, farthest):
        assert "the next loop, of tube" in contact_in_words(tubes, found, (1, distance / 100))
    assert ", loop 9;" in contact_in_words(tubes, found, (0, tubes[0].tube_length))


def test_tube_of_less_than_a_loop_has_no_next_one():
    tubes = design(0.25, (0.17, 0.26), loops=0.25, n_tubes=1)
    words = contact_in_words(tubes, layout(tubes), (0, tubes[0].tube_length))
    assert words.endswith("there is no other loop")


def test_picture_shows_every_part():
    pytest.importorskip("pyvista")
    tubes = design(0.25, (0.17, 0.26), loops=6, lead=0.05)
    picture = sleeve_scene.Picture(
        tubes=tuple(tubes),
        detection_range=layout(tubes).detection_range,
        outer_diameter=11.1e-3,
        contacts=((0, 0.8), (1, 1.2)),
        deviation=0.05,
        markers=np.full((3, 3), np.nan),
    )
    plotter = sleeve_scene.render(picture)
    # The arm; for each tube its dead part, the rest and the lead; for each contact two objects.
    assert len(plotter.renderer.actors) >= 1 + 2 * 3 + 2 * 2
    low, high = np.reshape(plotter.bounds, (3, 2))[2]
    assert low < -0.02
    assert high == pytest.approx(0.25 * 1.06, abs=0.01)
    plotter.close()
