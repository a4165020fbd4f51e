"""NaN and infinity are refused in whichever entry of whichever matrix they stand, at every door."""

import numpy as np
import pytest

from ufirext import (
    DelayHInfinityFilter,
    DelayKalmanFilter,
    FMSFilterSmoother,
    Model,
    NonFiniteError,
    UFIRFilter,
    filter_series,
    kinematic,
)

FILTERS = {
    "ufir": lambda n, m: UFIRFilter(n, m, horizon=12),
    "fms": lambda n, m: FMSFilterSmoother(n, m, horizon=12),
    "kalman": lambda n, m: DelayKalmanFilter(n, m),
    "h-infinity": lambda n, m: DelayHInfinityFilter(n, m),
}
NUMBERS = [np.nan, np.inf, -np.inf]


def spoilt(matrix, entry, number):
    """With that number at the entry and at its mirror image: the bits are symmetric."""
    spoilt = np.array(matrix, dtype=float)
    i, j = divmod(entry, spoilt.shape[1])
    spoilt[i, j] = number
    if spoilt.shape[0] == spoilt.shape[1]:
        spoilt[j, i] = number
    return spoilt


def settled(make, model):
    n, m = model.dim_x, model.dim_z
    f = make(n, m)
    f.F, f.H, f.R, f.Q = model.F, model.H, model.R, model.Q
    for k in range(30):
        f.predict()
        f.update(np.full(m, 0.1 * k))
    return f


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("axes", [1, 2, 4])
@pytest.mark.parametrize("name", ["F", "H", "Q", "R"])
def test_in_a_model(name, axes, number):
    model = kinematic(1, axes, 0.5, q=0.3)
    matrices = {"F": model.F, "H": model.H, "Q": model.Q, "R": model.R}
    for entry in range(matrices[name].size):
        with pytest.raises(NonFiniteError, match=name):
            Model(**{**matrices, name: spoilt(matrices[name], entry, number)})


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("axes", [1, 2, 4])
@pytest.mark.parametrize("name", ["F", "H", "Q", "R"])
def test_in_a_series(name, axes, number):
    model, zs = kinematic(1, axes, 0.5, q=0.3), np.zeros((20, axes))
    good = getattr(model, name)
    for entry in range(good.size):
        series = np.repeat(good[None], 20, axis=0)
        series[7] = spoilt(good, entry, number)
        arguments = (
            {f"{name}s": series} if name in "FH" else {"Fs": model.F[None].repeat(20, 0), f"{name}s": series}
        )
        with pytest.raises(NonFiniteError, match=name):
            filter_series(model, zs, 8, **arguments)


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("axes", [1, 2, 4])
@pytest.mark.parametrize("kind", FILTERS)
def test_in_a_filter(kind, axes, number):
    model = kinematic(1, axes, 0.5, q=0.3)
    f = settled(FILTERS[kind], model)
    for name in ("F", "H", "Q", "R", "P", "x"):
        good = np.array(getattr(f, name), dtype=float)
        for entry in range(good.size):
            with pytest.raises(NonFiniteError, match=name):
                setattr(f, name, spoilt(good, entry, number))
    x = f.x.copy()
    for name in ("F", "Q"):
        for entry in range(getattr(model, name).size):
            with pytest.raises(NonFiniteError, match=name):
                f.predict(**{name: spoilt(getattr(model, name), entry, number)})
    for name in ("H", "R"):
        for entry in range(getattr(model, name).size):
            with pytest.raises(NonFiniteError, match=name):
                f.update(np.zeros(axes), **{name: spoilt(getattr(model, name), entry, number)})
    np.testing.assert_array_equal(f.x, x)
