"""`acoustube live --library`: contacts of EchoTube's cycles, 80 kHz and 8 bits, as they arrive."""

import csv
import io
import os
import time
from pathlib import Path

import numpy as np
import pytest
from boards import Board
from commands import run_here
from rich.console import Console
from test_inversion import press, tool
from test_wrapped_inversion import WRAPPED, untouched, wrapped_presses

from acoustube.cli.live import run_live
from acoustube.ranging import Rangefinder, digitise, response
from acoustube.recordings.echotube_stream import PULSE_WIDTH_BYTES, encode
from acoustube.runs.libraries import files
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.live import Stream
from acoustube.runs.live_contacts import Contacts, Follower

needs_pty = pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo-terminal")
LENGTH, UNTOUCHED, PRESSED = 2.0, 16, 24
FINE = Rangefinder(sampling_rate=240e3, n_samples=6000, noise=1e-3)
SENSOR = "sampling_rate = 80e3\nbits = 8\nnoise = 1e-3\nlength_cm = 200\ntemperature_bias = 0.0\n"
BOARD = Rangefinder(sampling_rate=80e3, n_samples=2000, bits=8, noise=1e-3)


def cycle(presses, number):
    """Return the bytes of a cycle with presses (place, depth)."""
    return sampled([press(depth, place) for place, depth in presses], number)


def sampled(placed, number, length=LENGTH):
    """Return the bytes of a cycle, of every third sample of the voltage at 240 kHz."""
    _, voltage = response(placed, FINE, length=length, tube_seed=7)
    counts = digitise(voltage[::3].copy(), BOARD, np.array([number]), 3)[0]
    return counts[PULSE_WIDTH_BYTES:].astype(np.uint8)


def pressed(i):
    """Return place and depth of a press that deepens and slides."""
    return 0.7 + 0.0005 * i, 6e-3 * np.sin(np.pi / 2 * min(1.0, (i + 1) / 10)) ** 2


@pytest.fixture(scope="module")
def cycles():
    free = [cycle([], i) for i in range(UNTOUCHED)]
    return free + [cycle([pressed(i)], UNTOUCHED + i) for i in range(PRESSED)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("live")
    (plan,) = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    (where / "lib").mkdir()
    files.write_tool(where / "lib" / plan.name, tool(), plan)
    (where / "sensor.toml").write_text(SENSOR)
    return where


@needs_pty
def test_contacts_are_logged_and_shown_while_the_board_sends(folder, cycles, tmp_path):
    board, shown = Board(), io.StringIO()

    def send(board):
        start = time.monotonic() + 1.5  # the port is opened by then on a busy machine
        for i, one in enumerate(cycles):
            time.sleep(max(0.0, start + i / 20 - time.monotonic()))
            board.send(encode(i, one))

    how = Contacts(
        folder=folder / "lib", sensor=folder / "sensor.toml", rest=0.7, table=tmp_path / "c.csv"
    )
    Follower(how, 80e3, 2000, 20.0)  # its tables are kept, so that the next is made at once
    stream = Stream(port=board.port, prominence=0.05)
    with board.sending(send):
        tally = run_live(
            stream, Console(file=shown), out=tmp_path / "log.csv", duration=4.2, contacts=how
        )
    assert tally.n_cycles == len(cycles)
    assert len((tmp_path / "log.csv").read_text().splitlines()) == len(cycles) + 1
    with (tmp_path / "c.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    late = [row for row in rows if int(row["cycle"]) >= UNTOUCHED + 14]
    # All of the last ten cycles; fewer where the machine is too busy.
    busy = tally.n_skipped + tally.n_hurried
    assert len(late) + busy >= 10
    for row in late:
        place, depth = pressed(int(row["cycle"]) - UNTOUCHED)
        # 8 bits hardly resolve half wavelengths (4 mm), and the gain is known to 5 %. Where the
        # machine stalls, contacts are not sought in some cycles, others timed late: two half
        # wavelengths.
        near = 0.5 if busy == 0 else 1.0
        assert float(row["distance_cm"]) == pytest.approx(100 * place, abs=near), busy
        assert float(row["depth_mm"]) == pytest.approx(1e3 * depth, rel=0.06)
        assert float(row["probability"]) > 0.9
        assert (row["indenter_mm"], row["shape"]) == ("25", "rod")
    assert tally.found.contacts


@pytest.mark.slow
def test_contact_on_a_sleeve_is_followed(folder, tmp_path):
    """The echo has two to four counts: two half wavelengths in position, a tenth of the depth.

    The bore and nearly the resonance are known.
    """
    path = tmp_path / "sleeve.toml"
    known = "[priors]\nbore = 0\nresonance = 1e-3\n"
    path.write_text(SENSOR.replace("200\n", "250\n") + known + WRAPPED)
    follower = Follower(Contacts(folder=folder / "lib", sensor=path, rest=0.5), 80e3, 2000, 20.0)
    found = None
    for first, placed, count in ((0, untouched(), 12), (12, wrapped_presses((5e-3, 0.5)), 5)):
        for i in range(first, first + count):
            found = follower.update(sampled(placed, i, length=2.5), i / 20)
    (contact,) = found.contacts
    assert contact.distance.value == pytest.approx(0.5, abs=10e-3)
    assert contact.depth.value == pytest.approx(5e-3, rel=0.1)


def test_known_contacts_are_followed_while_cycles_wait(folder, cycles):
    """No others are sought; where many cycles wait, some are left out."""
    how = Contacts(folder=folder / "lib", sensor=folder / "sensor.toml", rest=0.1)
    follower = Follower(how, 80e3, 2000, 20.0)
    (contact,) = [follower.update(cycles[i], i / 20) for i in range(UNTOUCHED + 12)][-1].contacts
    searched = follower.tracker.n_searches
    for i in range(12, 14):
        (contact,) = follower.update(cycles[UNTOUCHED + i], (UNTOUCHED + i) / 20, 5).contacts
        assert contact.distance.value == pytest.approx(pressed(i)[0], abs=5e-3)
    assert (follower.n_hurried, follower.n_skipped) == (2, 0)
    assert follower.tracker.n_searches == searched
    assert follower.update(cycles[UNTOUCHED + 14], (UNTOUCHED + 14) / 20, 25) is None
    assert follower.update(cycles[UNTOUCHED + 15], (UNTOUCHED + 15) / 20, 5) is None
    assert follower.update(cycles[UNTOUCHED + 16], (UNTOUCHED + 16) / 20, 0).contacts
    assert (follower.n_hurried, follower.n_skipped) == (2, 2)
    assert follower.tracker.n_searches == searched + 1


def test_contacts_are_sought_now_and_then_although_cycles_always_wait(folder, cycles):
    """As where following takes as long as a cycle: then some are left out until none wait."""
    how = Contacts(folder=folder / "lib", sensor=folder / "sensor.toml", rest=0.1)
    follower = Follower(how, 80e3, 2000, 20.0)
    for i in range(12):
        follower.update(cycles[i], i / 20)
    found = [follower.update(cycles[12], (12 + i) / 20, waiting=10) for i in range(40)]
    n_hurried = sum(one is not None for one in found)
    assert 5 <= n_hurried <= 20
    assert found[n_hurried:] == [None] * (40 - n_hurried)


LATE_WRAP = "[wrap]\nlead_cm = 60\nloops = 9\nforearm_cm = [26, 18, 26.6]\n"


@pytest.mark.parametrize(
    ("sensor", "rate", "reason"),
    [
        ("bits = 12\nsampling_rate = 80e3", 80e3, "samples of 8 bits and the sensor has 12"),
        (
            "bits = 8\nsampling_rate = 200e3",
            80e3,
            "80000 Hz and the sensor sampling_rate",
        ),
        (None, 60e3, "aliases the band of a carrier of 42 kHz"),
        (
            f"bits = 8\nsampling_rate = 80e3\nlength_cm = 40\n{LATE_WRAP}",
            80e3,
            "has no place for a press",
        ),
    ],
)
def test_sensor_that_is_not_the_board_s_is_one_sentence(folder, tmp_path, sensor, rate, reason):
    path = None
    if sensor is not None:
        path = tmp_path / "sensor.toml"
        path.write_text(sensor)
    with pytest.raises(ValueError, match=reason):
        Follower(Contacts(folder=folder / "lib", sensor=path), rate, 2000, 20.0)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--contacts", "c.csv"), "--contacts needs --library"),
        (("--library", "nowhere"), "nowhere"),
        (("--library", "nowhere", "--out", "c.csv", "--contacts", "c.csv"), "name the same file"),
        (("--library", "nowhere", "--rest", "-1"), "rest"),
    ],
)
def test_wrong_options_are_one_sentence(words, reason):
    done = run_here("live", "--port", "nothing", *words)
    assert done.returncode == 2
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
    assert not Path("c.csv").exists()
