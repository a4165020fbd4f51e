"""Design of gains."""

from __future__ import annotations

from benchmarks.harness import MILLISECONDS, Contest, Row, Run
from ufirext import kinematic, ufir_gain


def _design(steps: int) -> Contest:
    """Gains of distinct models (another dt each), so that no cache answers."""
    designs = max(4, steps // 400)

    def prepare() -> Run:
        models = [kinematic(2, 3, 0.1 + 1e-4 * i) for i in range(designs)]

        def run() -> object:
            return [ufir_gain(model, 500).K[0, -1] for model in models]

        return run

    return Contest(prepare, None, designs)


ROWS = [Row("gains/K9-N500", "ufir_gain, one design", "absolute time", 0.4, _design, metric=MILLISECONDS)]
