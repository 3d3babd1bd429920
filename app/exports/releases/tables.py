"""The tables of a release, and the columns that it leaves out.

Left out is what would change the files of unchanged data (change counters), and what does not
follow from frozen figures, so that an erasure could not compute it anew. With a filter of statuses
there is no table of days, since a day covers everything that was eaten.
"""

from collections.abc import Collection, Mapping

from app.exports.export_spec import Rows
from app.http.columns.dictionary import Column
from app.http.columns.meal_columns import MEALS, PLACE, PROFILE

MANIFEST, FORMER_MANIFEST = "datapackage.json", "release.json"  # the latter until 0.4
DICTIONARY = "data-dictionary.csv"
TABLES: tuple[Rows, ...] = ("items", "meals", "days", "photographs", "participants")
LEFT_OUT: Mapping[Rows, Collection[str]] = {
    "items": ("change_seq",),
    "meals": ("version",),
    "days": ("energy_to_basal_rate", "plausibility"),
    "photographs": (),
    "participants": [column.name for column in MEALS],  # an erasure of a meal would change them
}
HASHES = (
    "left_received_sha256",
    "left_stored_sha256",
    "right_received_sha256",
    "right_stored_sha256",
)
PERSONAL_COLUMNS = frozenset(  # emptied for an anonymised participant
    {*HASHES, "visit", "excluded", *(column.name for column in (*PLACE, *PROFILE))}
)
KEYS: Mapping[str, tuple[str, ...]] = {
    "items": ("id",),
    "meals": ("participant", "meal_id"),
    "days": ("participant", "local_date"),
    "photographs": ("participant", "meal_id", "slot"),
    "participants": ("participant",),
    "foods": ("food_key", "food_version", "food_table"),
    "food_nutrients": ("food_key", "food_version", "food_table", "number"),
}
FOOD = (
    Column("food_key", "word", "The food's key: the same through releases and versions."),
    Column(
        "food_version",
        "integer",
        "The food's version in its table's release.",
        empty="Of any version.",
    ),
    Column("food_table", "word", "The food table's name and release.", empty="Of any table."),
)
FOODS = (
    *FOOD,
    Column("name", "word", "The food's name."),
    Column("food_group", "word", "Its group in the table."),
    Column("state", "word", "Raw, cooked ...", empty="The table does not say."),
    Column("is_mixed_dish", "boolean", "Whether it is a dish of several foods."),
)
FOOD_NUTRIENTS = (
    *FOOD,
    Column("number", "word", "The component's number in its source."),
    Column("tagname", "word", "INFOODS tagname.", empty="There is none."),
    Column("component", "word", "The component's name."),
    Column("unit", "word", "Unit of per_100_g."),
    Column("per_100_g", "number", "How much of it 100 g of the edible portion hold, in `unit`."),
)
FOOD_DENSITIES = (
    *FOOD,
    Column("measured_by", "word", "Whose figure it is.", values=("table", "study")),
    Column("g_per_ml", "number", "The density.", "g/ml"),
    Column("sd_g_per_ml", "number", "Its spread (one sd).", "g/ml"),
    Column("state", "word", "Of the food as it was measured."),
    Column(
        "kind",
        "word",
        "Of the food's own matter, or of a heap of pieces.",
        values=("solid", "bulk"),
    ),
    Column("basis", "word", "What kind of figure it is.", empty="Measured by the study."),
    Column("weighs", "word", "Of what the grams are.", values=("as_seen", "edible")),
    Column("source", "word", "Who measured it."),
)
OF_FOODS: Mapping[str, tuple[Column, ...]] = {
    "foods": FOODS,
    "food_nutrients": FOOD_NUTRIENTS,
    "food_densities": FOOD_DENSITIES,
}
