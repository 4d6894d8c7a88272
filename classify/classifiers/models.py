"""The classifiers, with the paper's settings or tuned on the training data."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import skops.io
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.calibration import CalibratedClassifierCV
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GridSearchCV, StratifiedKFold
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import BallTree, KDTree, KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.svm import SVC
from sklearn.tree import DecisionTreeClassifier
from sklearn.tree._tree import Tree

from classify.classifiers.familiar import Familiar
from classify.classifiers.names import ALL
from classify.classifiers.search import KernelSearch
from classify.pictures.feature_table import Features
from classify.pictures.features import describe, feature_names
from classify.pictures.sensor import level_between
from classify.pictures.settings import FeatureSettings
from generator.files.limits import check_archive
from generator.files.pictures import COLOUR_SPACE, Picture
from generator.files.toml import from_dict, to_dict
from generator.files.writing import atomic
from generator.model.errors import NlosError, instead
from generator.model.grid import VoxelGrid

Settings = Literal["paper", "tuned"]

FORMAT = 1
INNER_FOLDS = 3
_DEPTH = 30
"""Deepest nesting of objects that is accepted inside a classifier."""
_MANY = 3000
"""Pictures from which on a network stops early, and above which kernels would take more memory than time is worth."""

_SCALERS = [MinMaxScaler(), StandardScaler()]
_GRIDS: dict[str, dict[str, list[Any]]] = {
    "LR": {"scale": [StandardScaler()], "classify__C": [0.1, 1.0, 10.0, 100.0]},
    "LDA": {
        "scale": [StandardScaler()],
        "classify__solver": ["lsqr"],
        "classify__shrinkage": ["auto", 1e-3, 1e-2, 0.1, 0.5],
    },
    "KNN": {
        "scale": _SCALERS,
        "classify__n_neighbors": [1, 3, 5, 9, 15],
        "classify__weights": ["uniform", "distance"],
    },
    "CART": {"classify__min_samples_leaf": [1, 3, 10], "classify__max_features": [None, 0.5]},
    "RF": {"classify__max_features": ["sqrt", 0.3]},
    "SVM": {
        "scale": _SCALERS,
        "classify__C": [1.0, 10.0, 100.0, 1000.0],
        "classify__gamma": ["scale", 1e-3, 1e-2, 0.1],
    },
    "NB": {"scale": [StandardScaler()], "classify__var_smoothing": [1e-9, 1e-6, 1e-3, 1e-1, 1.0]},
    "MLP": {"scale": [StandardScaler()], "classify__alpha": [1e-2, 1.0, 30.0]},
}


def make(name: str, settings: Settings, feature_set: str, n_samples: int, *, seed: int = 0) -> Any:
    """Return an unfitted classifier that includes its scaler.

    Parameters
    ----------
    name : {"LR", "LDA", "KNN", "CART", "RF", "SVM", "NB", "MLP"}
    settings : {"paper", "tuned"}
        "paper": the SVM has an RBF kernel, C = 100 and gamma = 0.001 on global features (paper, section 6) and a
        linear kernel on the others (section 4), after scaling to [0, 1]. For the rest the paper states no settings,
        so they have scikit-learn's defaults. The network is not in the paper and has two layers of 64.
        "tuned": a grid search by 3 stratified folds of the data that it is fitted to.
    feature_set : {"global", "spatial-hog"}
    n_samples : int
        Number of samples that it will be fitted to; it limits the number of neighbours.
    seed : int
    """
    if name not in ALL:
        raise NlosError(f"classifier {name!r}: there is none; {instead(name, ALL.keys())}")
    kernel = "rbf" if settings == "tuned" or feature_set == "global" else "linear"
    estimators = {
        "LR": LogisticRegression(max_iter=5000),
        "LDA": LinearDiscriminantAnalysis(),
        "KNN": KNeighborsClassifier(n_neighbors=min(5, n_samples)),
        "CART": DecisionTreeClassifier(random_state=seed),
        "RF": RandomForestClassifier(n_estimators=100, random_state=seed),
        "SVM": SVC(kernel=kernel, C=100.0, gamma=0.001, random_state=seed),
        "NB": GaussianNB(),
        # With enough pictures, a tenth decides when to stop; with fewer, holding these out would cost too much.
        "MLP": MLPClassifier(
            (64, 64),
            alpha=1.0,
            max_iter=2000,
            early_stopping=n_samples >= _MANY,
            n_iter_no_change=20,
            random_state=seed,
        ),
    }
    scaler = StandardScaler() if name == "MLP" else MinMaxScaler()  # gradient steps need inputs of equal spread
    pipeline = Pipeline([("scale", scaler), ("classify", estimators[name])])
    if settings == "paper":
        return pipeline
    folds = StratifiedKFold(INNER_FOLDS, shuffle=True, random_state=seed)
    grid = dict(_GRIDS[name])
    if name == "KNN":
        most_neighbours = max(1, n_samples - -(-n_samples // INNER_FOLDS) - 1)
        grid["classify__n_neighbors"] = [k for k in grid["classify__n_neighbors"] if k <= most_neighbours]
    if name == "SVM" and n_samples <= _MANY:
        return KernelSearch(pipeline, grid, cv=folds)
    return GridSearchCV(pipeline, grid, cv=folds, error_score="raise")


def chosen(fitted: Any) -> dict[str, str]:
    """Return the settings that a search chose; empty if there was no search."""
    found = getattr(fitted, "best_params_", {})
    return {key.removeprefix("classify__"): str(value) for key, value in found.items()}


@dataclass(frozen=True)
class Model:
    """A trained classifier and all that it needs to classify a picture.

    Attributes
    ----------
    estimator : scikit-learn classifier
        Fitted, with ``predict_proba``.
    settings : FeatureSettings
    background : ndarray of shape (height, width, 3), float32
        Background picture of the training scene, W/m^2/sr.
    reference_radiance : float
        Reference radiance of that scene, W/m^2/sr.
    grid : VoxelGrid
    about : dict
        Classifier, its settings, the target, provenance of the features.
    familiar : Familiar or None
        What is familiar to it; None if it was trained on too few pictures, or by an older version.
    """

    estimator: Any
    settings: FeatureSettings
    background: Picture
    reference_radiance: float
    grid: VoxelGrid
    about: dict[str, Any]
    familiar: Familiar | None = None

    @property
    def colour_space(self) -> str:
        """The linear colour space of the training pictures."""
        provenance = self.about.get("provenance")
        return str(provenance.get("colour_space", COLOUR_SPACE)) if isinstance(provenance, dict) else COLOUR_SPACE

    def probabilities(
        self, picture: Picture, *, background: Picture | None = None, name: str = "picture"
    ) -> dict[str, float]:
        """Return the probability of each voxel for one picture; see `judged`."""
        return self.judged(picture, background=background, name=name)[0]

    def judged(
        self, picture: Picture, *, background: Picture | None = None, name: str = "picture"
    ) -> tuple[dict[str, float], float | None]:
        """Return the probability of each voxel for one picture, and how familiar it is.

        Parameters
        ----------
        picture : ndarray of shape (height, width, 3)
            W/m^2/sr.
        background : ndarray of shape (height, width, 3), optional
            Of the scene as it is now. If it differs from that of the training in its level alone, both pictures were
            exposed otherwise, which is made up for.
        name : str
            Name of the picture, for messages.

        Returns
        -------
        probability : dict of str to float
            Of each voxel, by label.
        misfit : float or None
            Probability that a picture like those of the training is as far from them; None if that is not known.
        """
        if background is not None and self.settings.input != "raw":
            level = np.float32(self.level_of(background)[0])
            picture, background = picture * level, background * level
        row = describe(
            picture,
            self.settings,
            reference=self.reference_radiance,
            background=self.background if background is None else background,
            name=name,
        )
        values = _answer(self.estimator, row, name)
        probability = {str(label): float(p) for label, p in zip(self.estimator.classes_, values, strict=True)}
        return probability, None if self.familiar is None else self.familiar.probability(row)

    def level_of(self, background: Picture) -> tuple[float, float]:
        """Return factor and difference in shape from a background to that of the training (`level_between`)."""
        own, wanted = (p.mean(axis=2, dtype=np.float64) for p in (background, self.background))
        return level_between(own, wanted)


def doubts(model: Model, background: Picture) -> list[str]:
    """Return what speaks against answers about a scene, by its background: another one than that of the training."""
    mismatch = 0.0 if model.settings.input == "raw" else model.level_of(background)[1]
    if not mismatch:
        return []
    return [
        f"do not rely on these answers: the empty scene differs from that of the training by {mismatch:.1%} in "
        "shape, so room, lamp, reflections or view are others"
    ]


def train(features: Features, name: str, settings: Settings, *, seed: int = 0) -> Model:
    """Fit a classifier to all of a data set's features.

    Raises
    ------
    NlosError
        If there is only one class, or a class has too few samples for the search and the calibration.
    """
    labels, counts = np.unique(features.labels, return_counts=True)
    unfitted = make(name, settings, features.settings.set, len(features.labels), seed=seed)
    check_seed(seed)
    check_classes(features.labels, INNER_FOLDS)
    check_varied(features)
    fitted = unfitted.fit(features.values, features.labels)
    chosen_settings = chosen(fitted)
    estimator = getattr(fitted, "best_estimator_", fitted)
    if not hasattr(estimator, "predict_proba"):
        estimator = CalibratedClassifierCV(clone(estimator), cv=INNER_FOLDS, ensemble=False)
        estimator.fit(features.values, features.labels)
    return Model(
        estimator=estimator,
        settings=features.settings,
        background=features.background,
        reference_radiance=features.reference_radiance,
        grid=features.grid,
        about={
            "classifier": name,
            "settings": settings,
            "chosen": chosen_settings,
            "target": features.target,
            "samples": dict(zip(map(str, labels), map(int, counts), strict=True)),
            "provenance": features.provenance,
        },
        familiar=Familiar.of(features.values, features.labels, seed=seed),
    )


def check_classes(labels: NDArray[np.str_], folds: int) -> None:
    """Raise NlosError unless there are two classes or more, each with a sample for every fold."""
    classes, counts = np.unique(labels, return_counts=True)
    if len(classes) < 2:
        raise NlosError(f"only one class ({', '.join(classes)}); telling voxels apart needs two or more")
    if counts.min() < folds:
        rarest = classes[counts.argmin()]
        raise NlosError(
            f"class {rarest} has {counts.min()} samples, fewer than the {folds} folds; render more poses or ask for "
            "fewer folds"
        )


def check_folds(labels: NDArray[np.str_], folds: int, settings: Sequence[Settings]) -> None:
    """Raise NlosError unless each fold leaves enough samples for training, and for the search if there is one."""
    check_classes(labels, folds)
    classes, counts = np.unique(labels, return_counts=True)
    rarest, samples = classes[counts.argmin()], int(counts.min())
    remaining = samples - -(-samples // folds)
    needed = INNER_FOLDS if "tuned" in settings else 2
    if remaining < needed:
        way_out = ", ask for more folds" if samples - 1 >= needed else ""  # at most one fold per sample
        way_out += ", or use --hyperparameters paper" if remaining >= 2 else ""
        raise NlosError(
            f"class {rarest} has {samples} samples, which leaves {remaining} to train on beside a test fold, and "
            f"{'the search for settings' if needed == INNER_FOLDS else 'training'} needs {needed}; render more poses"
            f"{way_out}"
        )


def check_varied(features: Features) -> None:
    """Raise NlosError if all pictures have the same features, or if this holds within every voxel."""
    values, labels = features.values, features.labels
    if not np.ptp(values, axis=0).any():
        raise NlosError("every picture has the same features, so nothing tells the voxels apart")
    if not any(np.ptp(values[labels == label], axis=0).any() for label in np.unique(labels)):
        raise NlosError("the pictures of each voxel all have the same features, so how they vary cannot be learnt")


def check_seed(seed: int) -> None:
    """Raise NlosError unless scikit-learn accepts the seed."""
    if not 0 <= seed < 2**32:
        raise NlosError(f"seed {seed}: must be from 0 to 2^32 - 1")


def save(path: Path, model: Model) -> None:
    """Write a model to a temporary file, and rename it."""
    bundle = {
        "format": FORMAT,
        "estimator": model.estimator,
        "background": model.background,
        "reference_radiance": model.reference_radiance,
        "settings": model.settings.to_json(),
        "grid": json.dumps(to_dict(model.grid)),
        "about": json.dumps(model.about),
    }
    if model.familiar is not None:
        bundle["familiar"] = model.familiar.arrays()
    with atomic(path) as temporary:
        skops.io.dump(bundle, temporary)


# Types inside scikit-learn's fitted classifiers that skops does not trust by default.
_TRUSTED = {
    "sklearn.calibration._CalibratedClassifier",
    "sklearn.calibration._SigmoidCalibration",
    "sklearn.metrics._dist_metrics.EuclideanDistance64",
    "sklearn.neighbors._kd_tree.KDTree",
    "sklearn.neighbors._ball_tree.BallTree",
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
    "sklearn.tree._tree.Tree",
}


def load(path: Path) -> Model:
    """Read a model without running any code from the file.

    Raises
    ------
    NlosError
        If the file is missing, is not a model, has a newer format, or holds a type unknown to this software.
    """
    if not path.is_file():
        raise NlosError(f"{path}: no such model file")
    try:
        check_archive(path)
        unknown = sorted(set(skops.io.get_untrusted_types(file=path)) - _TRUSTED)
    except Exception as error:  # many kinds: zip, JSON and key errors
        raise NlosError(f"{path}: is not a model file ({type(error).__name__}: {error})") from None
    if unknown:
        raise NlosError(
            f"{path}: holds the unknown type {unknown[0]}, which no model of this software has; not loaded"
        )
    try:
        bundle = skops.io.load(path, trusted=sorted(_TRUSTED))
        version = bundle["format"]
        newer = version > FORMAT
    except Exception as error:
        raise NlosError(f"{path}: is not a model file ({type(error).__name__}: {error})") from None
    if newer:
        raise NlosError(f"{path}: has model format {version}; this software reads up to {FORMAT}, so update it")
    try:
        model = Model(
            estimator=bundle["estimator"],
            settings=FeatureSettings.from_json(bundle["settings"]),
            background=np.asarray(bundle["background"], dtype=np.float32),
            reference_radiance=float(bundle["reference_radiance"]),
            grid=from_dict(VoxelGrid, json.loads(bundle["grid"]), "grid."),
            about=json.loads(bundle["about"]),
        )
        n_features = int(model.estimator.n_features_in_)
        if "familiar" in bundle:
            model = replace(model, familiar=Familiar.from_arrays(bundle["familiar"], n_features))
        _check_inside(model.estimator, n_features)
    except Exception as error:  # the contents may be wrong in many ways, NlosError among them
        raise NlosError(f"{path}: is not a model file ({type(error).__name__}: {error})") from None
    expected = len(feature_names(model.settings))
    if n_features != expected:
        raise NlosError(f"{path}: was trained on {n_features} features, but its settings give {expected}")
    if model.background.ndim != 3 or model.background.shape[2] != 3 or not np.isfinite(model.background).all():
        raise NlosError(f"{path}: holds no background picture of shape (height, width, 3) without NaN")
    if not (isinstance(model.about, dict) and 0.0 <= model.reference_radiance < np.inf):
        raise NlosError(f"{path}: does not tell its origin, or has no reference radiance of 0 or more")
    _answer(model.estimator, np.zeros(n_features), str(path))  # raises if the classifier cannot predict
    if not {name for label in model.estimator.classes_ for name in str(label).split("+")} <= set(model.grid.labels):
        raise NlosError(f"{path}: answers by other voxels than its grid has")
    return model


def _answer(estimator: Any, row: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return a classifier's probabilities (n_classes,); NlosError if it gives none, as foreign models may."""
    try:
        with np.errstate(all="ignore"):
            probabilities = np.asarray(estimator.predict_proba(row[None, :]), dtype=np.float64)
        valid = probabilities.shape == (1, len(estimator.classes_)) and bool(np.isfinite(probabilities).all())
    except Exception as error:
        raise NlosError(f"{name}: the model does not answer ({type(error).__name__}: {error})") from None
    if not valid:
        raise NlosError(f"{name}: the model's answer is no list of probabilities")
    answer: NDArray[np.float64] = probabilities[0]
    return answer


def _check_inside(estimator: Any, width: int) -> None:
    """Raise ValueError unless the arrays inside are as scikit-learn's compiled code assumes without checking."""
    for part in _parts(estimator):
        if isinstance(part, Tree):
            _check_tree(part, width)
        elif isinstance(part, KDTree | BallTree):
            _check_search(part, width)
        elif isinstance(part, KNeighborsClassifier) and hasattr(part, "_fit_X"):
            _check_neighbours(part, width)
        elif isinstance(part, SVC) and hasattr(part, "support_vectors_"):  # fitted
            _check_vectors(part, width)


def _parts(value: Any, depth: int = 0) -> Iterator[Any]:
    """Yield a fitted classifier and all objects inside it."""
    if depth > _DEPTH:
        raise ValueError("it is nested too deeply")
    yield value
    children: Iterable[Any] = ()
    if isinstance(value, list | tuple | set) or (isinstance(value, np.ndarray) and value.dtype == object):
        children = value
    elif isinstance(value, dict):
        children = value.values()
    elif type(value).__module__.startswith("sklearn."):
        children = vars(value).values() if hasattr(value, "__dict__") else ()
    for part in children:
        if not isinstance(part, str | bytes | int | float | np.generic):
            yield from _parts(part, depth + 1)


def _check_tree(tree: Any, width: int) -> None:
    count = tree.node_count
    left, right, feature = tree.children_left, tree.children_right, tree.feature
    inner = left != -1
    nodes = np.arange(count)
    # scikit-learn numbers each child after its parent.
    ordered = all(((child[inner] > nodes[inner]) & (child[inner] < count)).all() for child in (left, right))
    split_features = feature[inner]
    valid = (split_features >= 0).all() and (split_features < width).all()
    if not (count and ordered and (right[~inner] == -1).all() and valid):
        raise ValueError("a decision tree in it leads nowhere")
    if tree.value.shape != (count, tree.n_outputs, tree.max_n_classes):
        raise ValueError("a decision tree in it lacks answers")


def _check_search(tree: Any, width: int) -> None:
    data, index, nodes, _ = tree.get_arrays()
    first, last = nodes["idx_start"], nodes["idx_end"]
    count = len(data)
    complete = (
        data.ndim == 2
        and data.shape[1] == width
        and len(index) == count
        and np.array_equal(np.sort(index), np.arange(count))
    )
    if not (complete and (first >= 0).all() and (first <= last).all() and (last <= count).all()):
        raise ValueError("a tree of neighbours in it leads nowhere")


def _check_neighbours(machine: Any, width: int) -> None:
    data, labels, n_classes = machine._fit_X, machine._y, len(machine.classes_)
    if data.ndim != 2 or data.shape[1] != width or data.dtype != np.float64 or labels.shape != (len(data),):
        raise ValueError("its neighbours do not fit together")
    if labels.dtype.kind not in "iu" or labels.min() < 0 or labels.max() >= n_classes:
        raise ValueError("its neighbours are of no class")
    if not 1 <= machine.n_neighbors <= len(data) or machine.effective_metric_ not in ("euclidean", "minkowski"):
        raise ValueError("its neighbours cannot be asked")


def _check_vectors(machine: Any, width: int) -> None:
    vectors, counts = machine.support_vectors_, machine._n_support
    classes = len(machine.classes_)
    n = len(vectors)
    if machine.kernel not in ("rbf", "linear") or machine._impl != "c_svc" or machine.support_.shape != (n,):
        raise ValueError("it is no support vector machine of this software")
    pairs = classes * (classes - 1) // 2
    shapes = [vectors.shape, counts.shape, machine._dual_coef_.shape, machine._intercept_.shape]
    if shapes != [(n, width), (classes,), (classes - 1, n), (pairs,)] or counts.min() < 0 or counts.sum() != n:
        raise ValueError("its support vectors do not fit together")
    if {len(machine._probA), len(machine._probB)} - {0, pairs} or len(machine._probA) != len(machine._probB):
        raise ValueError("its probabilities do not fit together")
