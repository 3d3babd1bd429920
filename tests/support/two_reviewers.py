"""A made study: 60 people, 14 days, a dish a day, decided by two reviewers whose errors are known."""

import random

SEED = 20261130
PEOPLE, DAYS = 60, 14
FOODS = [f"food-{number}" for number in range(12)]
ERRORS = {"ann": (0.08, 1.03, 0.12), "bob": (0.15, 0.95, 0.20)}  # foods wrong; bias of grams, relative sd


def made_study():
    """(ann's, bob's) food and grams of each dish."""
    rng = random.Random(SEED)
    decisions = []
    for _ in range(PEOPLE * DAYS):
        food, grams = rng.choice(FOODS), rng.lognormvariate(5.0, 0.5)
        decisions.append(
            tuple(
                (rng.choice(FOODS) if rng.random() < wrong else food, grams * bias * rng.lognormvariate(0.0, sd))
                for wrong, bias, sd in ERRORS.values()
            )
        )
    return decisions
