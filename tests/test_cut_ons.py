"""Cut-on frequencies and stable time step: the discrete operator against Bessel's zeros."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh
from wave_lumens import BORE, pinched_tube, staircase, straight_tube

from acoustube.air import air_at
from acoustube.waves import cut_cells, cut_on_frequency, section_cut_ons, stable_step
from acoustube.waves.grid.small_cells import share_small_volumes
from acoustube.waves.scheme.leapfrog import initial_state, march
from acoustube.waves.scheme.operator import assemble, laplacian, with_halo
from acoustube.waves.scheme.problem import prepare
from acoustube.waves.scheme.time_step import _gershgorin, largest_eigenvalue

AIR = air_at(20.0)
OFFSETS = [(0.0, 0.0), (0.5, 0.5), (0.13, 0.37), (0.31, 0.07)]
CUT_ONS = [cut_on_frequency(m, 1, BORE, AIR.sound_speed) for m in (1, 1, 2, 2)]


def slice_of_tube(resolution, offset, n_layers=1):
    """A closed slice of whole layers, its axis shifted by an offset in cells."""
    h = 2 * BORE / resolution
    length = (n_layers - 0.5) * h
    return cut_cells(straight_tube(length, sections=512, shift=np.multiply(offset, h)), h)


def sparse_operator(operator):
    """The matrix of `laplacian` on one layer, from 25 applications to interleaved deltas."""
    nx, ny, _ = operator.inverse_volume.shape
    index = np.arange(nx * ny).reshape(nx, ny)
    i, j = np.indices((nx, ny))
    rows, columns, entries = [], [], []
    for a in range(5):
        for b in range(5):
            probe = np.zeros((nx, ny, 1))
            probe[a::5, b::5] = 1.0
            image = np.asarray(laplacian(with_halo(jnp.asarray(probe)), operator))[..., 0]
            # Every point lies within two cells of exactly one delta of this comb.
            source_i, source_j = i + (a - i + 2) % 5 - 2, j + (b - j + 2) % 5 - 2
            hit = np.flatnonzero(image)
            rows.append(hit)
            columns.append(index[source_i.flat[hit], source_j.flat[hit]])
            entries.append(image.flat[hit])
    shape = (nx * ny, nx * ny)
    triplets = (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_matrix(triplets, shape)


def cut_on_errors(resolution, offset):
    """Relative errors of both (1,1) and both (2,1) cut-ons, from the operator's eigenvalues."""
    cells = share_small_volumes(slice_of_tube(resolution, offset))
    with jax.enable_x64(True):
        matrix = sparse_operator(assemble(cells, AIR, 0.0, dtype=jnp.float64))
    volume = cells.volume_fraction.ravel()
    alive = volume > 0.0
    scale = sp.diags(np.sqrt(volume[alive]))
    symmetric = -scale @ matrix[alive][:, alive] @ sp.diags(1 / np.sqrt(volume[alive]))
    assert abs(symmetric - symmetric.T).max() < 1e-9 * abs(symmetric).max()
    squares = eigsh(symmetric.tocsc(), k=5, sigma=-1e9, return_eigenvectors=False)
    found = np.sqrt(np.sort(squares)[1:]) / (2 * np.pi)
    return found / CUT_ONS - 1.0


@pytest.mark.parametrize("offset", OFFSETS)
def test_operator_cuts_on_at_bessel_zeros(offset):
    """Right within 0.2 % at 32 cells per bore, wherever the wall lies within the cells."""
    errors = np.abs(cut_on_errors(32, offset))
    assert errors[:2].max() < 0.7e-3
    assert errors[2:].max() < 2.0e-3


def test_cut_ons_converge_at_second_order():
    """The order over 16, 32 and 64 cells of the larger error of two offsets is 1.8 or more."""
    worst = [
        np.abs([cut_on_errors(n, offset) for offset in OFFSETS[1:3]]).max(axis=0)
        for n in (16, 32, 64)
    ]
    order = np.log2(worst[0] / worst[2]) / 2.0
    assert order.min() > 1.8


def section_errors(resolution, walls):
    """Largest relative errors over all offsets of the five lowest cut-ons."""
    exact = [cut_on_frequency(m, 1, BORE, AIR.sound_speed) for m in (1, 1, 2, 2, 0)]
    found = [
        section_cut_ons(walls(slice_of_tube(resolution, offset, 2)), 1, AIR.sound_speed, 6)[1:]
        for offset in OFFSETS
    ]
    return np.abs(np.array(found) / exact - 1).max(axis=0)


def test_cut_ons_of_cut_cells_are_right_and_of_whole_cells_are_not():
    """Cut-ons of cut cells are compared with those of whole cells, at 16, 32 and 64 cells.

    Measured: cut cells at worst 0.74, 0.18, 0.04 %, of order 2.0 or more; whole cells 6.3, 2.5,
    1.2 %.
    """
    cut = np.array([section_errors(n, share_small_volumes) for n in (16, 32, 64)])
    whole = np.array([section_errors(n, staircase) for n in (16, 32, 64)])
    assert cut[1].max() < 2e-3
    assert np.min(np.log2(cut[0] / cut[2]) / 2) > 1.8
    assert np.all(whole > 3 * cut)
    assert np.min(np.log2(whole[0] / whole[2]) / 2) < 1.5


@pytest.mark.parametrize("offset", OFFSETS[1:3])
def test_closed_slice_rings_at_the_cut_ons(offset):
    """Spectral peaks after a random start; 8 ms resolve them to a few Hz, 0.02 %."""
    cells = slice_of_tube(32, offset, n_layers=2)
    setup = prepare(cells, AIR, probes=(0.0,), source_end="rigid", far_end="rigid")
    alive = setup.cells.volume_fraction > 0.0
    rng = np.random.default_rng(3)
    coarse = rng.normal(size=setup.cells.shape[:2])[:, :, None] * alive
    spot = np.zeros((*alive.shape[:2], 1))
    # Off the axes and near the wall: no mode of interest has a node there.
    spot[tuple(np.add(np.array(alive.shape[:2]) // 2, (11, 7)))] = 1.0
    scheme = setup.scheme._replace(probe_weights=jnp.asarray(spot, jnp.float32))
    setup = replace(setup, scheme=scheme)
    n_steps = int(8e-3 / setup.time_step)
    _, signal = march(setup, initial_state(setup, coarse), np.zeros(n_steps))
    peaks = spectral_peaks(signal[0], setup.time_step, 20e3, 50e3)
    for cut_on in CUT_ONS[::2]:
        assert np.abs(peaks / cut_on - 1.0).min() < 2e-3
    assert all(np.abs(peak / np.array(CUT_ONS) - 1.0).min() < 2e-3 for peak in peaks)


def spectral_peaks(signal, time_step, lowest, highest):
    """Frequencies of the strong peaks in a band, by a parabola through the log spectrum."""
    windowed = (signal - signal.mean()) * np.blackman(len(signal))
    level = np.log(np.abs(np.fft.rfft(windowed)) + 1e-30)
    step = 1.0 / (len(signal) * time_step)
    k = np.arange(int(lowest / step), int(highest / step))
    top = k[(level[k] > level[k - 1]) & (level[k] > level[k + 1])]
    top = top[level[top] > level[k].max() - np.log(30.0)]
    left, middle, right = level[top - 1], level[top], level[top + 1]
    return (top + 0.5 * (left - right) / (left - 2 * middle + right)) * step


def test_stable_step_is_close_to_the_exact_limit():
    """The largest eigenvalue is compared with ARPACK's on one layer, within 1 %.

    Gershgorin's bound is the largest sum of a row's magnitudes. The step stays above 0.9 of that of
    a Cartesian grid.
    """
    cells = share_small_volumes(slice_of_tube(16, (0.13, 0.37)))
    with jax.enable_x64(True):
        operator = assemble(cells, AIR, 0.0, dtype=jnp.float64)
        matrix = sparse_operator(operator)
        found = largest_eigenvalue(operator)
    exact = -eigsh(
        symmetrised(matrix, cells.volume_fraction.ravel()), k=1, which="SA",
        return_eigenvectors=False,
    )[0]  # fmt: skip
    assert found == pytest.approx(exact, rel=0.01)
    assert _gershgorin(operator) == pytest.approx(abs(matrix).sum(axis=1).max(), rel=1e-12)
    cells = cut_cells(pinched_tube(0.03, 0.6), 2 * BORE / 20, half=True)
    cartesian = cells.spacing[0] / (AIR.sound_speed * np.sqrt(3.0))
    assert 0.9 * cartesian < stable_step(cells, AIR) < cartesian


def symmetrised(matrix, volume):
    """The operator in coordinates in which it is symmetric."""
    root = np.sqrt(np.where(volume > 0.0, volume, 1.0))
    return sp.diags(root) @ matrix @ sp.diags(1.0 / root)
