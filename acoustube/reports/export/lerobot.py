"""Cycles as episodes for robot learning, in the layout of LeRobotDataset v3.0.

A frame is one cycle: a send pulse and the recording of its echoes. An episode is the cycles of one
press in one recording session.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from acoustube.base.writing import write
from acoustube.reports.export.sounds import episodes, labels
from acoustube.reports.export.tables import check_parquet

CODEBASE = "v3.0"
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
PLACE = ("chunk_index", "file_index")
FILES_PER_CHUNK, FILE_MEGABYTES = 1000, 100
TASK = "Tell from the echo whether, where, how deep and how hard the tube is pressed."
ACTION = ("touched", "distance_m", "depth_m", "force_N")
"""Labels to estimate; the last three are zero without a contact."""
COUNTED = ("timestamp", "frame_index", "episode_index", "index", "task_index")

Columns = dict[str, NDArray[Any]]


def write_episodes(data: xr.Dataset, folder: Path) -> str:
    """Write cycles as the episodes of a LeRobotDataset.

    Parameters
    ----------
    data : xarray.Dataset
        Cycles, from :func:`acoustube.open_dataset`.
    folder : Path
        Empty folder.

    Returns
    -------
    str
        Numbers of frames and episodes, in words.

    Raises
    ------
    ConfigError
        If the package for Parquet is missing.

    Notes
    -----
    ``observation.signal`` are the samples less half the ADC's full scale (less the sensor's offset
    if they are not quantised), divided by half the full scale: -1 to 1. ``observation.temperature``
    is the reported temperature in degC; ``action`` are the labels (:data:`ACTION`). Columns
    ``press``, ``tube`` and ``session`` of ``meta/episodes`` identify an episode, for splits.
    """
    check_parquet("lerobot")
    table, rate = labels(data), _frames_per_second(data)
    stats, listed = _Stats(), []
    with _Files(folder, data.sizes["time"]) as files:
        for number, part in enumerate(np.split(np.arange(len(table)), episodes(table)[1:])):
            columns = _frames(data, table, part) | _numbers(number, part, rate)
            stats.add(columns)
            chunk, file = files.write(columns)
            listed.append(_episode(number, part, table, chunk, file))
    _write_meta(folder, data, listed, stats, rate)
    return f"{len(table)} frames in {len(listed)} episodes"


class _Files:
    """Context manager that writes frames to Parquet files, each with whole episodes."""

    def __init__(self, folder: Path, n_samples: int) -> None:
        self.folder = folder
        self.frames = max(1, int(FILE_MEGABYTES * 1e6 / (4 * n_samples)))
        self.number, self.room = -1, 0
        self.writer: Any = None

    def __enter__(self) -> _Files:
        return self

    def __exit__(self, *error: object) -> None:
        if self.writer is not None:
            self.writer.close()
            if error[:1] == (None,):
                write(self.path, self.content.getvalue())

    def write(self, columns: Columns) -> tuple[int, int]:
        """Write an episode; return the numbers of its chunk (folder) and of its file there."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        frames = pa.table({name: _arrow(values) for name, values in columns.items()})
        if self.writer is None or self.room < len(frames):
            self.__exit__(None)
            self.number, self.room = self.number + 1, self.frames
            name = FILE.format(**dict(zip(PLACE, self.place, strict=True)))
            self.path, self.content = self.folder / "data" / name, io.BytesIO()
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.writer = pq.ParquetWriter(self.content, frames.schema)
        self.writer.write_table(frames)  # as one row group, which can be read alone
        self.room -= len(frames)
        return self.place

    @property
    def place(self) -> tuple[int, int]:
        """Number of the chunk (folder), and of the current file in it."""
        chunk, file = divmod(self.number, FILES_PER_CHUNK)
        return chunk, file


def _frames_per_second(data: xr.Dataset) -> int:
    """Return the number of cycles per second, rounded to an integer as LeRobot requires."""
    rangefinder = json.loads(data.attrs.get("rangefinder", "{}"))
    return max(1, round(float(rangefinder.get("cycle_rate", 20.0))))


def _middle(data: xr.Dataset) -> float:
    """Return half the full scale in counts, or the sensor's offset if samples are not quantised."""
    full_scale = float(data.attrs["full_scale"])
    if data["signal"].dtype.kind != "f":
        return 0.5 * full_scale
    rangefinder = json.loads(data.attrs.get("rangefinder", "{}"))
    return full_scale * rangefinder.get("offset", 0.0) / rangefinder.get("full_scale", 1.0)


def _frames(data: xr.Dataset, table: pd.DataFrame, part: NDArray[np.int64]) -> Columns:
    """Return observations and labels, a row for each cycle."""
    half, middle = 0.5 * float(data.attrs["full_scale"]), _middle(data)
    rows = table.iloc[part]
    counts = data["signal"].isel(cycle=slice(part[0], part[-1] + 1)).values
    touched = rows["depth"].to_numpy() > 0
    labels = [touched, *(rows[name].to_numpy() for name in ("true_distance", "depth", "force"))]
    action = np.stack(labels, axis=-1).astype(np.float32)
    return {
        "observation.signal": ((counts - middle) / half).astype(np.float32),
        "observation.temperature": rows["temperature"].to_numpy().astype(np.float32),
        "action": np.where(touched[:, None], action, np.float32(0)),
    }


def _numbers(number: int, part: NDArray[np.int64], rate: int) -> Columns:
    """Return the times in s and the indices of an episode's frames, in the columns of LeRobot."""
    frame = np.arange(len(part))
    return {
        "timestamp": (frame / rate).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(len(part), number),
        "index": part,
        "task_index": np.zeros(len(part), int),
    }


def _arrow(values: NDArray[Any]) -> Any:
    import pyarrow as pa

    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _episode(
    number: int, part: NDArray[np.int64], table: pd.DataFrame, chunk: int, file: int
) -> dict[str, Any]:
    """Return an episode's row of ``meta/episodes``: where its frames are, and its labels."""
    first = table.iloc[part[0]]
    return {
        "episode_index": number,
        "tasks": [TASK],
        "length": len(part),
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": int(part[0]),
        "dataset_to_index": int(part[-1]) + 1,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        **{name: str(first[name]) for name in ("press", "tube", "session")},
    }


class _Stats:
    """Minimum, maximum, mean and standard deviation of each column, accumulated over episodes."""

    def __init__(self) -> None:
        self.known: dict[str, list[Any]] = {}
        self.count = 0

    def add(self, columns: Columns) -> None:
        """Add the frames of an episode to the statistics."""
        self.count += len(columns["index"])
        for name, values in columns.items():
            x = values.reshape(len(values), -1).astype(float)
            part = x.min(axis=0), x.max(axis=0), x.sum(axis=0), (x**2).sum(axis=0)
            self.known.setdefault(name, []).append(part)

    def in_json(self) -> dict[str, Any]:
        """Return the statistics as the content of ``meta/stats.json``."""
        found = {}
        for name, parts in self.known.items():
            lows, highs, totals, squares = (np.array(part) for part in zip(*parts, strict=True))
            low, high = lows.min(axis=0), highs.max(axis=0)
            mean = totals.sum(axis=0) / self.count
            variance = np.maximum(squares.sum(axis=0) / self.count - mean**2, 0.0)
            found[name] = {
                "min": low.tolist(), "max": high.tolist(), "mean": mean.tolist(),
                "std": np.sqrt(variance).tolist(), "count": [self.count],
            }  # fmt: skip
        return found


def _features(n: int) -> dict[str, Any]:
    """Return the type, shape and names of each column, for cycles of n samples."""
    found: dict[str, Any] = {
        "observation.signal": {"dtype": "float32", "shape": [n], "names": None},
        "observation.temperature": {"dtype": "float32", "shape": [1], "names": None},
        "action": {"dtype": "float32", "shape": [len(ACTION)], "names": list(ACTION)},
    }
    for name in COUNTED:
        kind = "float32" if name == "timestamp" else "int64"
        found[name] = {"dtype": kind, "shape": [1], "names": None}
    return found


def _write_meta(
    folder: Path, data: xr.Dataset, listed: list[dict[str, Any]], stats: _Stats, rate: int
) -> None:
    """Write the metadata of the dataset: its description, episodes, tasks and statistics."""
    meta = folder / "meta"
    info = {
        "codebase_version": CODEBASE,
        "robot_type": "acoustube",
        "total_episodes": len(listed),
        "total_frames": stats.count,
        "total_tasks": 1,
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": FILE_MEGABYTES,
        "video_files_size_in_mb": 0,
        "fps": rate,
        "splits": {"train": f"0:{len(listed)}"},
        "data_path": f"data/{FILE}",
        "video_path": None,
        "features": _features(data.sizes["time"]),
        "sampling_rate": float(data.attrs["sampling_rate"]),
    }
    path = meta / "episodes" / FILE.format(chunk_index=0, file_index=0)
    path.parent.mkdir(parents=True)
    write(path, pd.DataFrame(listed).to_parquet(index=False))
    tasks = pd.DataFrame({"task_index": [0]}, index=pd.Index([TASK], name="task"))
    write(meta / "tasks.parquet", tasks.to_parquet())
    for name, content in (("info", info), ("stats", stats.in_json())):
        text = json.dumps(content, indent=2) + "\n"
        write(meta / f"{name}.json", text)
