"""A filter's own gain, certified."""

from __future__ import annotations

import pytest

from ufirext import UFIRFilter, UnobservableWindow, kinematic
from ufirext.errors import UfirextError


def test_the_gain_of_a_filter_is_the_best_unbiased_one():
    model = kinematic(1, 1, 1.0, q=0.1, r=4.0)
    f = UFIRFilter(2, 1, horizon=8)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    assert f.certify().optimal


def test_a_model_that_nothing_determines_has_no_gain_to_certify():
    with pytest.raises((UfirextError, UnobservableWindow)):
        UFIRFilter(2, 1, horizon=8).certify()
