"""Do the 95 % intervals that the commands print hold the truth 95 times in 100?

    python benchmarks/interval_coverage.py -o DIR [--only NAME] [--draws N]

Every interval is drawn N times (default: 1000; of whole commands 500) from pictures whose truth is known, by the
functions that the commands call. Writes DIR/coverage.csv, a row for each case: how often the interval held the truth,
the standard error of that share, and, where pictures depend on one another or the best is chosen, how often an
interval does that takes no account of it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import interval_cases as cases
import interval_commands as commands
import numpy as np
import results

from classify.intervals import Interval

ALL = (
    *(cases.shares, cases.scores, cases.located, cases.alarms, cases.tracked, cases.worth, cases.compared),
    *(cases.traded, cases.planned, cases.changed, cases.checked, cases.chosen),
    *(commands.probed, commands.settled, commands.detected, commands.bounded, commands.regions),
    *(commands.folds, commands.learned),
)
SLOW = 500
"""Most draws of a slow case."""
RESULTS = {
    "coverage": (
        "interval",
        "printed by",
        "n",
        "setting",
        "held, %",
        "error, %",
        "as independent, %",
        "draws",
        "93 to 97",
    )
}
"""``n`` counts pictures, frames, poses, rounds or repeats; the last column says whether that share is 93 to 97 %."""


def rows_of(number: int, case: cases.Case, draws: int) -> Iterator[list[object]]:
    """Yield the row of each interval of a case."""
    draws = min(draws, SLOW) if case.slow else draws
    drawn = [case.draw(np.random.default_rng([number, k])) for k in range(draws)]
    plain = "" if drawn[0][1] is None else f"{100.0 * float(np.mean([x for _, x in drawn])):.1f}"
    found = zip(*(held if isinstance(held, list) else [held] for held, _ in drawn), strict=True)
    for printed, one in zip([case.printed] if isinstance(case.printed, str) else case.printed, found, strict=True):
        held = share_held(one)
        error = math.sqrt(max(held * (1.0 - held), 1.0 / draws) / draws)
        verdict = "yes" if 0.93 <= held <= 0.97 else "above" if held > 0.97 else "below"
        numbers = [f"{100.0 * held:.1f}", f"{100.0 * error:.1f}", plain, draws]
        yield [case.name, printed, case.count, case.setting, *numbers, verdict]


def share_held(found: tuple[cases.Held, ...]) -> float:
    """Return the share of intervals that hold the truth."""
    drawn = [one for one in found if isinstance(one, Interval)]
    if not drawn:
        return float(np.mean(found))
    truth = float(np.mean([one.value for one in drawn]))
    return float(np.mean([cases.holds(one, truth) for one in drawn]))


def main() -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--only", choices=[group.__name__ for group in ALL], help="of one kind alone")
    parser.add_argument("--draws", type=int, default=1000, metavar="N")
    options = parser.parse_args()
    if options.draws < 1:
        parser.error(f"--draws {options.draws}: must be 1 or more")
    rows = []
    for number, group in enumerate(ALL):
        if options.only in (None, group.__name__):
            for k, case in enumerate(group()):
                for row in rows_of(1000 * number + k, case, options.draws):
                    rows.append(row)
                    print(*row, sep=" | ", flush=True)
    results.write(options.output, "coverage", RESULTS["coverage"], rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
