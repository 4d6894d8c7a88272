"""What the search for the settings of the SVM takes, sharing what candidates have in common, and by scikit-learn.

Both search the same candidates with the same folds on nine tenths of each file of features, as a fold of `compare`
does. The script fails if they do not give every candidate the same accuracy.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import results
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, StratifiedKFold
from threadpoolctl import threadpool_limits

from classify.classifiers import models
from classify.pictures import feature_table

RESULTS = {
    "searches": (
        "features",
        "processor seconds, scikit-learn",
        "processor seconds, shared",
        "ratio",
    )
}


def seconds(search: Any, x: Any, y: Any) -> float:
    """Return the processor time of a fit."""
    start = time.process_time()
    search.fit(x, y)
    return time.process_time() - start


def main() -> None:
    """Time both searches and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("features", type=Path, nargs="+", help="files of features")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the table")
    parser.add_argument("--times", type=int, default=3, help="runs of each, of which the median counts")
    options = parser.parse_args()
    table = []
    for path in options.features:
        features = feature_table.read(path)
        rows, _ = next(StratifiedKFold(10, shuffle=True, random_state=0).split(features.values, features.labels))
        x, y = features.values[rows], features.labels[rows]
        shared = models.make("SVM", "tuned", features.settings.set, len(rows))
        plain = GridSearchCV(clone(shared.estimator), shared.param_grid, cv=shared.cv)
        with threadpool_limits(1):  # as in a worker of `compare`
            runs = [(seconds(plain, x, y), seconds(shared, x, y)) for _ in range(options.times)]
        if shared.scores_.ravel().tolist() != plain.cv_results_["mean_test_score"].tolist():
            raise SystemExit(f"{path}: the two searches differ")
        before, after = (statistics.median(column) for column in zip(*runs, strict=True))
        row = (features.settings.set, f"{before:.2g}", f"{after:.2g}", f"{before / after:.2g}")
        print(*row, flush=True)
        table.append(row)
    results.write(options.output, "searches", RESULTS["searches"], table)


if __name__ == "__main__":
    main()
