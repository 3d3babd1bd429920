"""Confusions of a food that is taught: each of its examples, named by all others.

A task of the limited child: stored vectors in -> ranked foods out.
"""

from pathlib import Path

import numpy as np
from pydantic import BaseModel

from app.candidates.vcm_json import StoredPiece
from app.children.child import Arguments, StageListener
from app.identification.examples import Examples, NumberedIndex
from app.identification.food_index import open_index
from app.identification.identifier import Circumstances, Identifier
from app.meals.stored.run_answer import Json

BY_LOOKS = Circumstances(looks_alone=True)


class _RankRequest(BaseModel):
    """Pieces to rank, and what by.

    index: its file; None: the shipped one
    pieces: to rank
    learned: what the study has named
    """

    index: Path | None
    pieces: list[StoredPiece]
    learned: list[StoredPiece]


def rank_task(arguments: Arguments, _: StageListener) -> Json:
    """Name each piece by its looks, by the index, what is learned and the other pieces.

    Returns name -> (food's key, its name, probability) of each food, likeliest first.
    """
    request = _RankRequest.model_validate(arguments)
    numbered = NumberedIndex(open_index(request.index))
    others = Examples(numbered)
    for piece in (*request.learned, *request.pieces):
        others.put(piece.examples())
    ranked: Json = {}
    for piece in request.pieces:
        views = piece.examples()
        if not views:
            continue
        left_out = others.take([view.name for view in views])
        vectors = np.stack([view.vector for view in views])
        identified = Identifier(numbered, others).identify(vectors, BY_LOOKS)
        others.append(*left_out)
        ranked[piece.name] = [
            [candidate.food_key, candidate.name or candidate.food_key, candidate.probability]
            for candidate in identified.candidates
        ]
    return ranked
