"""What x is never depends on which engine ran: every engine against the records, on random streams."""

from __future__ import annotations

import numpy as np
import pytest

from .streams import MODELS, Stream, fresh, reference

STREAMS = {
    "plain": {},
    "lost": {"lost": 0.3},
    "skipped": {"skip": 0.2},
    "bursts": {"lost": 0.85},
    "late": {"late": 0.3},
    "late and lost": {"late": 0.3, "lost": 0.3},
    "weights": {"weight": 0.3, "lost": 0.1},
    "inputs": {"input": 0.5},
    "edits": {"edit": 0.2, "edit before": 0.2},
    "edits and losses": {"edit": 0.1, "edit before": 0.1, "lost": 0.3, "late": 0.1},
    "varying": {"F": 0.5, "H": 0.1},
    "rarely varying": {"F": 0.005, "lost": 0.02},
    "copies": {"copy": 0.1, "pickle": 0.05, "lost": 0.1, "edit": 0.05},
    "all": {
        "lost": 0.2, "skip": 0.05, "late": 0.1, "weight": 0.1, "input": 0.1, "edit": 0.05,
        "edit before": 0.05, "F": 0.05, "H": 0.03, "component": 0.05, "again": 0.05,
        "copy": 0.02, "pickle": 0.01,
    },
}  # fmt: skip


@pytest.mark.parametrize("events", STREAMS)
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(
    ("horizon", "options"),
    [(5, {}), (8, {"window": "origins"}), (12, {"missing": "skip"}), (20, {}), (7, {"missing": "predict"})],
    ids=["5", "8-origins", "12-skip", "20", "7-predict"],
)
def test_every_engine_is_the_reference(name, events, horizon, options):
    model, rng = MODELS[name], np.random.default_rng([horizon, *map(ord, name + events)])
    stream = Stream(
        model, [fresh(model, horizon, **options), reference(model, horizon, **options)], rng, STREAMS[events]
    )
    for step in range(110):
        stream.step()
        fast, slow = stream.filters
        if rng.random() < 0.5:  # an estimate nobody reads is worked out later
            np.testing.assert_allclose(fast.x, slow.x, rtol=1e-7, atol=1e-7, err_msg=f"x at step {step}")
        if rng.random() < 0.1:
            assert fast.ready == slow.ready
            assert fast.rows == slow.rows
            assert fast.dropped == slow.dropped
            for quantity in (
                "P",
                "x_prior",
                "P_prior",
                "x_post",
                "P_post",
                "y",
                "S",
                "K",
                "z",
                "log_likelihood",
            ):
                ours, theirs = getattr(fast, quantity), getattr(slow, quantity)
                if getattr(ours, "dtype", None) is np.dtype(object):
                    assert theirs.dtype == object
                    continue
                np.testing.assert_allclose(
                    ours, theirs, rtol=1e-6, atol=1e-6, err_msg=f"{quantity} at step {step}"
                )
