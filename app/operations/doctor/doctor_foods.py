"""Checks of what names foods: an operator's index and network."""

from collections.abc import Collection
from pathlib import Path

from app.candidates.classify import (
    CLASSIFIER_SECONDS,
    FoodClassifier,
    classify_request,
    failure_of,
    read_classifier,
)
from app.children.api_children import TASKS
from app.children.child_pool import ChildPool, ChildStartError
from app.core.errors import Failure, TadaError
from app.core.settings import Settings
from app.foods import queries as foods
from app.identification.food_index import open_index
from app.operations.doctor.finding import LISTED, Deployment, Verdict, bad, note, ok
from app.vision.looks.vcm import VCM_VERSION


def look_at_food_index(deployment: Deployment) -> Verdict | None:
    """Check that the operator's index can be read and used, and that the food table has its foods."""
    path = deployment.settings.food_index
    if path is None:
        return None
    try:
        index = open_index(path)
    except TadaError as error:
        return bad(
            f"{error.message} Meals get no candidates.", "Build it again by `tada index build`."
        )
    if index.vcm_version != VCM_VERSION:
        return bad(
            f"{path} was built for vectors of version {index.vcm_version}, not {VCM_VERSION}: meals get no candidates.",
            "Build it again by `tada index build`.",
        )
    keys = {food.food_key for food in index.foods}
    return _unknown_foods(deployment, keys) or ok(f"{index.version}: {len(keys)} foods")


def look_at_classifier(deployment: Deployment) -> Verdict | None:
    """Check the operator's network: file and digest, that it loads and fits its description, and its foods."""
    path = deployment.settings.classifier
    if path is None:
        return None
    classifier = read_classifier(path)
    failure = (
        classifier
        if isinstance(classifier, Failure)
        else _try_network(classifier, deployment.settings)
    )
    if isinstance(classifier, Failure) or failure is not None:
        message = failure.message if failure is not None else ""
        return bad(
            f"{message} Meals get the candidates of the index alone.",
            "Correct TADA_CLASSIFIER or unset it.",
        )
    keys = {key for key in classifier.food_keys if key is not None}
    return _unknown_foods(deployment, keys) or ok(f"{classifier.version}: {len(keys)} foods")


def _try_network(classifier: FoodClassifier, settings: Settings) -> Failure | None:
    """Load the network in a limited child and show it a grey picture; None: it answers as described."""
    children = ChildPool(settings, TASKS)
    try:
        request = classify_request(classifier, Path(), [], max_pixels=settings.max_photo_pixels)
        return failure_of(children.run(request, lambda _: None, seconds=CLASSIFIER_SECONDS))
    except ChildStartError as error:
        return Failure(
            "classifier_crashed", f"No process could be started to try the model: {error}."
        )
    finally:
        children.close()


def _unknown_foods(deployment: Deployment, keys: Collection[str]) -> Verdict | None:
    """Note the foods that cannot be chosen."""
    with deployment.database.read() as session:
        unknown = sorted(set(keys) - foods.foods_by_key(session, keys).keys())
    if not unknown:
        return None
    return note(
        f"{len(unknown)} of its {len(keys)} foods are in no food table in force: {', '.join(unknown[:LISTED])}.",
        "They are no candidates until a table has foods with these keys.",
    )
