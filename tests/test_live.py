"""The stream of a board: from bytes to frames, to distances, and the command on a pseudo-terminal.

The simulated board sends the data of EchoTube's firmware: 2000 bytes per cycle, COBS-encoded and
zero-terminated, with the pulse width in the first two.
"""

import csv
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from boards import CYCLES, DISTANCES, FRAMES, SPEED, TIME, Board, burst, cycles_at
from commands import run_here
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from acoustube import signals
from acoustube.base.errors import ConfigError
from acoustube.cli import live
from acoustube.cli.live import trace
from acoustube.recordings.echotube_stream import (
    PULSE_WIDTH_BYTES,
    Decoder,
    Receiver,
    encode,
)
from acoustube.runs.live import RATE, Stream
from acoustube.signals import Processing, Tracker
from acoustube.signals.calibration import arctan_fall

COMMAND = str(Path(sys.executable).with_name("acoustube"))
HOW = signals.without_aliased_template(Processing(prominence=0.05), RATE)
needs_pty = pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo-terminal")

# Sampling 42 kHz at 80 kHz shifts a peak by up to 9 mm, as `without_aliased_template` states.
TOLERANCE = 0.012


def run_live(port, console, *, out=None, duration=None, **stream):
    """Run the command's function on a stream, with given settings."""
    return live.run_live(Stream(port=port, **stream), console, out=out, duration=duration)


# ---------------------------------------------------------------------------------------------
# The tracker


def test_streaming_is_the_batch():
    """Distances agree to rounding, the deviation to a few per cent."""
    batch = signals.locate(TIME, CYCLES, HOW, temperature=24.0)
    tracker = Tracker(TIME, HOW)
    single = [tracker.update(cycle, temperature=24.0) for cycle in CYCLES]
    for name in ("envelope", "send_time", "send_amplitude", "return_time", "amplitude",
                 "prominence", "distance", "detected"):  # fmt: skip
        found = np.stack([getattr(ranging, name) for ranging in single])
        np.testing.assert_allclose(found, getattr(batch, name), rtol=1e-9, atol=1e-12)
    deviations = np.stack([ranging.distance_deviation for ranging in single])
    np.testing.assert_allclose(deviations, batch.distance_deviation, rtol=1e-9)
    assert (tracker.n_cycles, tracker.n_detections) == (40, 40)


def test_tracker_counts_silent_cycles_without_detection_and_refuses_others():
    tracker = Tracker(TIME, HOW)
    assert not tracker.update(np.full(TIME.size, 128, np.uint8)).detected
    tracker.update(CYCLES[0])
    with pytest.raises(ValueError, match=r"shape \(40, 1998\)"):
        tracker.update(CYCLES)
    assert (tracker.n_cycles, tracker.n_detections) == (2, 1)
    with pytest.raises(ValueError, match="half the sampling rate"):
        Tracker(TIME, Processing())


def test_undersampled_carrier_is_located_without_the_matched_filter():
    """Errors over 1.7 m: mean under 1 mm, standard deviation 4 mm, none over 12 mm."""
    distances = np.linspace(0.3, 2.0, 300)
    error = signals.locate(TIME, cycles_at(distances), HOW).distance - distances
    assert abs(np.mean(error)) < 1e-3
    assert np.std(error) == pytest.approx(4e-3, abs=1e-3)
    assert np.max(np.abs(error)) < TOLERANCE
    assert signals.without_aliased_template(Processing(), 200e3) == Processing()
    assert Processing(prominence=0.05, template_cycles=None) == HOW


def test_template_at_the_alias_frequency_would_be_worse():
    """With a template at 38 kHz distances would vary 1.8 times as much as without one."""
    distances = np.linspace(0.3, 2.0, 300)
    share = 38 / 42
    alias = Processing(
        frequency=38e3, pulse_cycles=11 * share, template_cycles=10 * share, prominence=0.05
    )
    plain = Processing(template_cycles=None, prominence=0.05)
    with_filter, without = (
        signals.locate(TIME, cycles_at(distances), how).distance - distances
        for how in (alias, plain)
    )
    assert with_filter.std() > 1.5 * without.std()


PLACES = np.repeat(np.arange(0.25, 2.0, 0.05), 6) + np.tile(np.arange(6) * 0.7e-3, 35)
"""In groups of six, over which the phase of the carrier runs through 2 pi."""


def blocked():
    """Cycles of closures whose echoes fall as an arctangent, as `test_calibration` has them."""
    heights = arctan_fall(PLACES, -0.25, 2.0, 0.9, 0.42)
    clean = burst(np.zeros(1), TIME) + heights[:, None] * burst(2 * PLACES / SPEED, TIME)
    hiss = np.random.default_rng(2).normal(scale=0.003, size=clean.shape)
    return np.rint(128 + 100 * (clean + hiss)).clip(0, 255).astype(np.uint8)


def untouched():
    clean = np.repeat(burst(np.zeros(1), TIME), 30, axis=0)
    hiss = np.random.default_rng(3).normal(scale=0.003, size=clean.shape)
    return np.rint(128 + 100 * (clean + hiss)).clip(0, 255).astype(np.uint8)


@needs_pty
def test_calibration_of_undersampled_cycles_is_found_and_used(board):
    found = signals.calibrate(TIME, blocked(), PLACES, untouched(), sigmas=8)
    assert found.processing.template_cycles is None
    assert found.slope.value == pytest.approx(1.0, abs=2e-3)
    assert abs(found.intercept.value) < 2e-3
    signals.save(found, "c.toml")
    paced(board, 40, 40.0, before=0.3)
    run_live(board.port, Console(quiet=True), calibration="c.toml", out=Path("a.csv"), duration=2.5)
    places = [float(row["distance_cm"]) for row in logged("a.csv")]
    assert places == pytest.approx(100 * DISTANCES, abs=100 * TOLERANCE)
    with pytest.raises(ConfigError, match="100000 samples per second and the calibration 80000"):
        run_live(board.port, Console(quiet=True), calibration="c.toml", rate=100e3)


# ---------------------------------------------------------------------------------------------
# The decoder


def fed(decoder, pieces):
    return [frame for piece in pieces for frame in decoder.feed(piece)]


def cut(data, sizes):
    """Cut bytes into pieces of the given sizes, repeated."""
    start, pieces = 0, []
    while start < len(data):
        for size in sizes:
            pieces.append(data[start : start + size])
            start += size
    return pieces


def counts(decoder):
    return decoder.n_frames, decoder.n_garbled, decoder.n_joined


@given(st.binary(min_size=3, max_size=3000), st.integers(0, 65535))
@settings(deadline=None)
def test_any_payload_survives(samples, width):
    line = encode(width, np.frombuffer(samples, np.uint8))
    assert line.count(0) == 1
    assert line[-1] == 0
    decoder = Decoder(len(samples) + PULSE_WIDTH_BYTES)
    (frame,) = decoder.feed(line)
    assert (frame.pulse_width, frame.samples.tobytes()) == (width, samples)
    assert counts(decoder) == (1, 0, 0)


def test_what_is_no_byte_is_not_encoded():
    (frame,) = Decoder(5.0).feed(encode(np.int64(1200), [7, 8, 9]))
    assert (frame.pulse_width, frame.samples.tolist()) == (1200, [7, 8, 9])
    for width, samples in ((0, [256]), (0, [-1]), (0, [0.5]), (65536, [1]), (-1, [1])):
        with pytest.raises(ConfigError, match=r"^(samples|pulse_width) = "):
            encode(width, samples)


def test_pulse_width_has_its_high_byte_first():
    (frame,) = Decoder(5).feed(b"\x06\x12\x34\x07\x08\x09\x00")
    assert frame.pulse_width == 0x1234
    assert frame.samples.tolist() == [7, 8, 9]


@given(st.lists(st.integers(1, 700), min_size=1, max_size=20), st.integers(0, 2500))
@settings(deadline=None, max_examples=50)
def test_pieces_of_any_size_give_the_same_frames(sizes, skipped):
    """The stream includes garbled frames, and starts within a frame."""
    data = b"".join(FRAMES[:3]) + FRAMES[3][50:] + b"\0\0" + FRAMES[4] + b"\1" * 9000 + FRAMES[5]
    data = data[skipped:] + FRAMES[6]
    whole, pieced = Decoder(), Decoder()
    expected, found = whole.feed(data), fed(pieced, cut(data, sizes))
    assert [f.pulse_width for f in found] == [f.pulse_width for f in expected]
    assert all(np.array_equal(a.samples, b.samples) for a, b in zip(found, expected, strict=True))
    assert counts(pieced) == counts(whole)


def test_single_bytes_give_the_same_frames():
    data = b"".join(FRAMES[:4])
    found = fed(Decoder(), [data[i : i + 1] for i in range(len(data))])
    assert [frame.pulse_width for frame in found] == [1000, 1001, 1002, 1003]
    assert all(
        np.array_equal(frame.samples, cycle) for frame, cycle in zip(found, CYCLES, strict=False)
    )


def garbled(frame, kind):
    """Return a damaged frame, and as how many garbled pieces it must be counted.

    A lost byte is detected in 92 % of the frames (`Decoder`); those that are used here are among
    them.
    """
    middle = len(frame) // 2
    return {
        "byte lost": (frame[:middle] + frame[middle + 1 :], 1),
        "byte doubled": (frame[:middle] + frame[middle - 1 :], 1),
        "end lost": (frame[:middle] + b"\0", 1),
        "code past the end": (b"\xff" * 9 + b"\0", 1),
        "zero within": (frame[:middle] + b"\0" + frame[middle + 1 :], 2),
        "zero lost": (frame[:-1] + b"\x01" + frame, 1),
        "no zero for long": (b"\x55" * 100_000 + b"\0", 1),
        "idle zeros": (b"\0" * 50, 0),
    }[kind]


KINDS = [
    "byte lost", "byte doubled", "end lost", "code past the end", "zero within", "zero lost",
    "no zero for long", "idle zeros",
]  # fmt: skip


@given(st.lists(st.sampled_from([None, *KINDS]), min_size=1, max_size=12))
@settings(deadline=None, max_examples=60)
def test_garbled_frames_are_counted_exactly(kinds):
    decoder, expected, bad = Decoder(), 1, 0
    decoder.feed(FRAMES[0])
    for kind in kinds:
        line, pieces = (FRAMES[1], 0) if kind is None else garbled(FRAMES[1], kind)
        decoder.feed(line)
        expected, bad = expected + (kind is None), bad + pieces
    assert counts(decoder) == (expected, bad, 0)


def test_line_that_is_joined_in_the_middle_is_not_garbled():
    decoder = Decoder()
    found = fed(decoder, [FRAMES[0][700:], FRAMES[1], FRAMES[2][:-1], b"\0"])
    assert [frame.pulse_width for frame in found] == [1001, 1002]
    assert counts(decoder) == (2, 0, 1)


def test_stream_without_zero_is_cut_off_and_counted_once():
    decoder = Decoder()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(1000):
        assert decoder.feed(b"\x55" * 10_000) == []
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert counts(decoder) == (0, 1, 0)
    assert decoder.n_bytes == 10_000_000
    assert grown < 20_000  # a frame and the spare capacity of a bytearray
    assert [frame.pulse_width for frame in decoder.feed(b"\0" + FRAMES[5])] == [1005]
    assert counts(decoder) == (1, 1, 0)


@pytest.mark.long
def test_memory_is_flat_over_thousands_of_frames():
    """A record of 3000 cycles would take 6 MB of samples and 48 MB of envelopes."""
    decoder, tracker = Decoder(), Tracker(TIME, HOW)
    line = b"".join(FRAMES[:10])

    def some(n):
        for _ in range(n):
            for frame in decoder.feed(line):
                tracker.update(frame.samples)

    some(5)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    some(100)
    middle = tracemalloc.get_traced_memory()[0]
    some(100)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert decoder.n_frames == tracker.n_cycles == 2050
    assert after - middle < 50_000
    assert after - before < 500_000


# ---------------------------------------------------------------------------------------------
# The receiver


class Scripted:
    """A port that returns bytes at once, and then fails or is silent."""

    def __init__(self, *pieces, then=None):
        self.pieces, self.then = list(pieces), then
        self.emptied = threading.Event()

    @property
    def in_waiting(self):
        return len(self.pieces[0]) if self.pieces else 0

    def read(self, size=1):
        if self.pieces:
            head, rest = self.pieces[0][:size], self.pieces[0][size:]
            self.pieces[:1] = [rest] if rest else []
            return head
        self.emptied.set()
        if self.then is not None:
            raise self.then
        time.sleep(0.01)
        return b""


def test_oldest_cycles_are_dropped_and_counted_when_nobody_takes_them():
    port = Scripted(b"".join(FRAMES[:10]))
    with Receiver(port, Decoder(), depth=4) as receiver:
        assert port.emptied.wait(5)
        taken = [receiver.take()[1].pulse_width for _ in range(4)]
        assert receiver.take() is None
    assert taken == [1006, 1007, 1008, 1009]
    assert receiver.n_dropped == 6


def test_what_came_before_the_failure_is_still_there():
    port = Scripted(*FRAMES[:3], then=OSError("gone"))
    with Receiver(port, Decoder()) as receiver:
        assert port.emptied.wait(5)
        taken = [receiver.take()[1].pulse_width for _ in range(3)]
    assert taken == [1000, 1001, 1002]
    assert str(receiver.failure) == "gone"
    assert receiver.take() is None


@needs_pty
def test_defect_in_the_reading_thread_is_not_reported_as_a_cut_cable(board, monkeypatch):
    def broken(*_):
        raise TypeError("a defect")

    monkeypatch.setattr(Decoder, "feed", broken)
    threading.Timer(0.3, board.send, [b"\0"]).start()
    with pytest.raises(TypeError, match="a defect"):
        run_live(board.port, Console(quiet=True), duration=5)


# ---------------------------------------------------------------------------------------------
# The command on a pseudo-terminal


@pytest.fixture
def board():
    board = Board()
    yield board
    board.cut()


def logged(path):
    with Path(path).open(newline="") as file:
        return list(csv.DictReader(file))


def wait_for_rows(path, n, seconds=60):
    """Wait until a log has rows, and return them."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if Path(path).exists() and Path(path).read_text().count("\n") > n:
            return logged(path)
        time.sleep(0.02)
    raise AssertionError(f"{path} has not got {n} rows in {seconds} s")


def wait_for_log(path):
    return wait_for_rows(path, 0)


def started(board, out, *words):
    """Start the command and wait until it listens."""
    command = subprocess.Popen(
        [COMMAND, "live", "--port", board.port, "--prominence", "0.05", "--out", out, *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    wait_for_log(out)
    return command


@needs_pty
def test_command_finds_every_cycle_and_ends_when_the_cable_is_cut(board):
    """After the cable is connected again a new log begins."""
    command = started(board, "a.csv")
    board.send(FRAMES[0][300:])
    for frame in FRAMES:
        board.send(frame)
    broken, _ = garbled(FRAMES[3], "byte lost")
    board.send(broken)
    board.send(FRAMES[0])
    before_cut = wait_for_rows("a.csv", 41)
    board.send(FRAMES[1][:900])
    board.cut()
    output, errors = command.communicate(timeout=60)
    assert command.returncode == 1
    assert "41 cycles at" in output
    assert "echoes in 41, 1 garbled, 0 dropped, latency" in " ".join(output.split())
    assert "reception began within a frame" in " ".join(output.split())
    told = " ".join(errors.split())
    assert "was lost after 41 intact cycles, a.csv holds them; connect the board" in told
    assert "Traceback" not in errors
    rows = logged("a.csv")
    assert rows == before_cut
    assert list(rows[0]) == [
        "cycle", "time_of_flight_ms", "distance_cm", "amplitude", "prominence", "n_peaks",
        "detected", "file", "received_s", "pulse_width",
    ]  # fmt: skip
    assert [int(row["cycle"]) for row in rows] == list(range(41))
    assert [int(row["pulse_width"]) for row in rows] == [*range(1000, 1040), 1000]
    found = np.array([float(row["distance_cm"]) for row in rows])
    assert found[:40] == pytest.approx(100 * DISTANCES, abs=100 * TOLERANCE)
    received = np.array([float(row["received_s"]) for row in rows])
    assert np.all(np.diff(received) >= 0)
    assert abs(received[-1] - time.time()) < 60

    again = Board()
    try:
        refused = subprocess.run(
            [COMMAND, "live", "--port", again.port, "--out", "a.csv"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert refused.returncode == 2
        assert "nothing is overwritten" in refused.stderr
        command = started(again, "b.csv")
        again.send(FRAMES[7])
        assert wait_for_rows("b.csv", 1)[0]["pulse_width"] == "1007"
        command.send_signal(signal.SIGINT)
        _, errors = command.communicate(timeout=60)
    finally:
        again.cut()
    assert command.returncode == 130
    assert "interrupted; 1 cycle at" in errors
    assert "b.csv holds them" in errors


@needs_pty
def test_log_that_is_there_is_kept(board):
    Path("a.csv").write_text("of yesterday")
    with pytest.raises(ConfigError, match=r"cannot be written \(File exists\); name a new file"):
        run_live(board.port, Console(quiet=True), out=Path("a.csv"), duration=1.0)
    assert [path.name for path in Path().iterdir()] == ["a.csv"]
    assert Path("a.csv").read_text() == "of yesterday"


def test_cycles_are_in_the_log_within_20_ms_of_their_last_byte(board):
    """The median latency of 100 cycles at 20 per second, as measured by the command."""
    paced(board, 100, 20.0, before=0.3)
    tally = run_live(
        board.port, Console(file=StringIO()), prominence=0.05, out=Path("a.csv"), duration=6.0
    )
    assert tally.n_cycles == 100
    assert tally.n_detections == 100
    assert tally.latency < 0.02
    assert len(logged("a.csv")) == 100
    assert (tally.n_garbled, tally.n_joined, tally.n_dropped) == (0, 0, 0)


@needs_pty
def test_slow_processing_drops_whole_cycles_and_counts_each(board, monkeypatch):
    """The last cycle is processed, and all others are processed or counted as dropped."""
    update = Tracker.update

    def slow(self, *words):
        time.sleep(0.02)
        return update(self, *words)

    monkeypatch.setattr(Tracker, "update", slow)
    threading.Timer(0.3, board.send, [b"".join(FRAMES * 5)]).start()
    tally = run_live(board.port, Console(quiet=True), out=Path("a.csv"), duration=3.0)
    assert tally.n_dropped > 20
    assert tally.n_cycles + tally.n_dropped == 200
    assert tally.n_garbled == 0
    assert logged("a.csv")[-1]["pulse_width"] == "1039"


def paced(board, n, rate, before):
    """Send cycles from another thread at a rate per second, each byte at 1 Mbaud."""

    def send():
        start = time.monotonic() + before
        for i in range(n):
            time.sleep(max(0.0, start + i / rate - time.monotonic()))
            frame = FRAMES[i % len(FRAMES)]
            for piece in range(0, len(frame), 200):  # 2 ms of the line
                board.send(frame[piece : piece + 200])
                time.sleep(0.002)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    return thread


@needs_pty
@pytest.mark.long
def test_fifteen_seconds_at_20_cycles_per_second_lose_nothing(board):
    command = started(board, "a.csv", "--duration", "17")
    paced(board, 300, 20.0, before=0.0)
    output, errors = command.communicate(timeout=60)
    assert command.returncode == 0, errors
    assert len(logged("a.csv")) == 300
    told = " ".join(output.split())
    assert "echoes in 300, 0 garbled, 0 dropped" in told
    assert len(re.findall(r"cm, amplitude 0\.\d+; \d+ cycles at", told)) == 1  # after 10 s
    assert float(re.findall(r"latency ([\d.]+) ms", told)[-1]) < 20


@needs_pty
def test_terminal_shows_a_panel_with_the_trace(board):
    paced(board, 20, 20.0, before=0.2)
    screen = StringIO()
    console = Console(file=screen, force_terminal=True, width=120)
    run_live(board.port, console, prominence=0.05, duration=1.6)
    text = screen.getvalue()
    assert "cm, amplitude" in text
    assert "█" in text
    assert "20 cycles at" in text


@needs_pty
def test_silent_and_foreign_lines_are_reported(board):
    text = StringIO()
    threading.Timer(0.2, board.send, [b"\x55" * 3000]).start()
    tally = run_live(board.port, Console(file=text), duration=0.6)
    assert tally.n_cycles == 0
    assert "no intact cycle in 3000 bytes, 1 garbled; check the baud rate" in text.getvalue()
    quiet = StringIO()
    run_live(board.port, Console(file=quiet, quiet=True), duration=0.1)
    assert quiet.getvalue() == ""


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--port", "/dev/none-such"], "port = /dev/none-such cannot be opened"),
        (["--port", "x", "--calibration", "nobody"], "nobody is neither a file nor the name"),
        (["--port", "x", "--temperature", "400"], "temperature = 400 is out of range"),
        (["--port", "x", "--frame-bytes", "20"], "too short"),
        (["--port", "x", "--duration", "-1"], "duration = -1 is out of range"),
        (["--port", "x", "--baud", "9600.5"], "baud = 9600.5 is not a whole number"),
        ([], "port"),
    ],
)
def test_wrong_words_are_refused(words, part):
    result = run_here("live", *words)
    assert result.returncode == 2, result.stderr
    assert part in " ".join(result.stderr.split())
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("module", ["serial", "cobs"])
def test_missing_library_is_named_with_its_install_command(monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=r"pip install 'acoustube\[serial\]'"):
        run_live("x", Console(quiet=True))


def test_trace_is_forty_decibels_high():
    """Levels of 0, -20 and -40 dB fill the bar, half of it and none of it; silence fills none."""
    assert trace(np.array([1.0, 0.1, 0.01, 0.0, np.nan]), width=5) == "█▄   "
