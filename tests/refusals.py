"""Errors of arguments that are refused, by their fields."""

import pytest

from acoustube.base.errors import ConfigError


def refused(call, **fields):
    """Return the error of a call, which must have the given fields and state its value."""
    with pytest.raises(ConfigError) as caught:
        call()
    error = caught.value
    assert {name: getattr(error, name) for name in fields} == fields
    if error.setting is not None:
        assert str(error).startswith(f"{error.setting} = ")
    assert error.advice in str(error)
    return error
