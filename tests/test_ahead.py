"""Functions that are compiled in the background are those that a press or a march calls later."""

import threading

import numpy as np
import pytest
from numba import typeof
from test_compiled import AIR, BAND
from wave_lumens import BORE, pinched_tube

from acoustube.base.ahead import compile_ahead
from acoustube.indentation import MeshSize, element, indent, multifrontal
from acoustube.tube import Tube
from acoustube.waves import cut_cells
from acoustube.waves.scheme import cpu_ahead, cpu_leapfrog
from acoustube.waves.scheme.leapfrog import march
from acoustube.waves.scheme.problem import prepare


@pytest.fixture
def types_of_calls(monkeypatch):
    """A function that runs another one, and returns the argument types of each compiled call."""

    def found(module, name, run):
        kernel, types = getattr(module, name), set()

        def recording(*arguments):
            types.add(tuple(typeof(argument) for argument in arguments))
            return kernel(*arguments)

        with monkeypatch.context() as patched:
            patched.setattr(module, name, recording)
            run()
        return types

    return found


@pytest.mark.parametrize(
    ("module", "name", "ahead"),
    [
        (element, "_contracted", element.compile_contraction),
        (multifrontal, "_rows", multifrontal.compile_kernels),
        (multifrontal, "_storage", multifrontal.compile_kernels),
        (multifrontal, "_add", multifrontal.compile_kernels),
    ],
)
def test_a_press_calls_what_was_compiled_ahead(types_of_calls, module, name, ahead):
    def press():
        indent(Tube(), depth=1e-4, mesh=MeshSize(through_wall=1, around=5, along=6))

    called = types_of_calls(module, name, press)
    assert called
    assert called <= types_of_calls(module, name, ahead)


@pytest.mark.parametrize("lossy", [False, True])
def test_a_march_calls_what_was_compiled_ahead(types_of_calls, lossy):
    cells = cut_cells(pinched_tube(0.03, 0.8), 2 * BORE / 8, half=True)
    setup = prepare(cells, AIR, probes=(0.005,), lossy_band=BAND if lossy else None)

    def marched():
        march(setup, setup.state, np.zeros(1), layers=np.array([8]), compiled=True)

    called = types_of_calls(cpu_leapfrog, "advance", marched)
    assert called
    assert called == types_of_calls(
        cpu_ahead, "advance", lambda: cpu_ahead.compile_march(lossy=lossy)
    )


def test_compilations_follow_each_other_in_another_thread_whatever_fails():
    done = []

    def fails():
        raise ValueError

    steps = [lambda: done.append(threading.current_thread()), fails, lambda: done.append(None)]
    thread = compile_ahead(steps)
    thread.join(10.0)
    assert done == [thread, None]
    assert thread is not threading.current_thread()
