"""The forest predicts what scikit-learn's trees do, goes to bytes and back, and knows what it was fitted to."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingClassifier

from upvl_cli.perception.objectness.prior import shipped_prior
from upvl_cli.perception.objectness.track_features import FEATURES
from upvl_cli.perception.objectness.trees import Forest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def training() -> ModuleType:
    """The script that fits the prior."""
    spec = importlib.util.spec_from_file_location("objectness_training", ROOT / "training" / "objectness.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_arrays_predict_what_the_trees_do(training: ModuleType) -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(400, len(FEATURES)))
    features[rng.random(features.shape) < 0.1] = np.nan
    target = np.nan_to_num(features[:, 0]) + np.isnan(features[:, 1]) > 0.3
    trees = HistGradientBoostingClassifier(max_iter=20, max_leaf_nodes=6, min_samples_leaf=10, random_state=0)
    forest = training.to_forest(trees.fit(features, target))
    np.testing.assert_allclose(forest.probability(features), trees.predict_proba(features)[:, 1], atol=1e-12)
    again = Forest.from_bytes(forest.to_bytes())
    assert again.probability(features).tobytes() == forest.probability(features).tobytes()
    assert (again.names, again.fitted_to) == (forest.names, forest.fitted_to)
    assert forest.probability(features[:0]).shape == (0,)


def test_bytes_that_are_no_trees_are_refused() -> None:
    with pytest.raises(ValueError, match="no file of trees"):
        Forest.from_bytes(b"\x00" * 40)


def test_the_shipped_prior_is_no_staler_than_the_code_that_makes_the_boxes(training: ModuleType) -> None:
    prior = shipped_prior()
    assert prior.names == FEATURES
    assert prior.fitted_to == training.fitted_to(), (
        "what makes the boxes, or what is measured on them, has changed since the prior was fitted; "
        "run: python training/objectness.py"
    )
