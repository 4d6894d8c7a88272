"""Names of the classifiers: a module of its own, so that a command line can list them without loading them."""

NAMES = {
    "LR": "logistic regression",
    "LDA": "linear discriminant analysis",
    "KNN": "k nearest neighbours",
    "CART": "decision tree",
    "RF": "random forest",
    "SVM": "support vector machine",
    "NB": "Gaussian naive Bayes",
}

ALL = {**NAMES, "MLP": "small neural network"}
"""The paper's classifiers, and one that needs more pictures than the paper had."""
