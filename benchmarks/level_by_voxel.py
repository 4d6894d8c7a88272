"""How well does the mean level alone tell voxels apart? Prints its 5th, 50th and 95th percentile for each voxel.

The level is the mean of a picture minus that of the background, in thousandths of the background.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from generator.sets.dataset import Dataset


def main() -> None:
    """Read the data sets and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    for path in parser.parse_args().datasets:
        data = Dataset.open(path)
        empty = data.background().mean()
        print(f"{path}\nvoxel      5 %     50 %     95 %")
        for label in data.grid.labels:
            level = [data.picture(p).mean() / empty * 1e3 - 1e3 for p in data.records if p.label == label]
            print(f"{label:>5}", *(f"{q:8.2f}" for q in np.percentile(level, [5, 50, 95])))


if __name__ == "__main__":
    main()
