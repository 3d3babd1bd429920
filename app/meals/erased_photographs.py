"""Photographs that are gone before their meal is: erased by the study's policy, or replaced by another pair."""

from collections.abc import Collection
from datetime import datetime

from sqlalchemy.orm import Session

from app.meals.models import MealImage
from app.people import privacy_queries as people_privacy


def erase_failed_pair(session: Session, images: Collection[MealImage], now: datetime) -> None:
    """Photographs of an after-meal pair that could not be measured, when another is sent: rows and blobs."""
    people_privacy.want_deleted(session, [image.blob_key for image in images], now)
    for image in images:
        session.delete(image)
    session.flush()
