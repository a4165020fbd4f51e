"""How far a long run is: a callable of the caller, or rich's progress bar when asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["Progress", "ticking"]

Progress = bool | Callable[[int, int], object]


@contextmanager
def ticking(progress: Progress, total: int) -> Iterator[Callable[[int], None]]:
    """A function that is told how many samples were done; the caller's is told (done, total)."""
    if not progress:
        yield lambda samples: None
    elif callable(progress):
        done = 0

        def report(samples: int) -> None:
            nonlocal done
            done += samples
            progress(done, total)

        yield report
    else:
        with _bar(total) as advance:
            yield advance


@contextmanager
def _bar(total: int) -> Iterator[Callable[[int], None]]:
    try:
        from rich.progress import Progress as Bar
    except ImportError as error:
        raise ImportError("progress=True needs rich: pip install rich; or give a callable") from error
    with Bar() as bar:
        task = bar.add_task("filtering", total=total)
        yield lambda samples: bar.update(task, advance=samples)
