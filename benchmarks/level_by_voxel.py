"""How well does the mean level alone tell voxels apart? Prints its 5th, 50th and 95th percentile for each voxel.

The level is the mean of a picture minus that of the background, in thousandths of the background. ``-o DIR`` writes
the table there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import results

from generator.sets.dataset import Dataset

RESULTS = {"level-by-voxel": ("data set", "voxel", "5 %", "50 %", "95 %")}


def main() -> None:
    """Read the data sets and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="folder for the table as a file too")
    options = parser.parse_args()
    table = []
    for path in options.datasets:
        data = Dataset.open(path)
        empty = data.background().mean()
        print(f"{path}\nvoxel      5 %     50 %     95 %")
        for label in data.grid.labels:
            level = [data.picture(p).mean() / empty * 1e3 - 1e3 for p in data.records if p.label == label]
            levels = [f"{q:.1f}" for q in np.percentile(level, [5, 50, 95])]
            table.append((path.name, label, *levels))
            print(f"{label:>5}", *(f"{level:>8}" for level in levels))
    if options.output:
        results.write(options.output, "level-by-voxel", RESULTS["level-by-voxel"], table)


if __name__ == "__main__":
    main()
