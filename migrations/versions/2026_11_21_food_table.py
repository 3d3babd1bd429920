"""the food table: imports, versions, numbers of components, search, recomputation

Components are kept by their source's number, no longer by tagname; which release is in force is a row of its own; each
item keeps the food and the density that it was weighed with.

Revision ID: 20261121_food_table
Revises: 20261121_unknown_volume
Create Date: 2026-11-21 14:40:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261121_food_table"
down_revision = "20261121_unknown_volume"
branch_labels = None
depends_on = None

INSTANT = sa.DateTime(timezone=True)
JSON_VALUE = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")
WORD = sa.String(length=64).with_variant(sa.String(length=64, collation="C"), "postgresql")
TRIGRAM = sa.String(length=3).with_variant(sa.String(length=3, collation="C"), "postgresql")

# Of the components that the first migration's tables can hold (the starter table's), by tagname.
NUMBERS = {
    "WATER": "255", "ENERC_KCAL": "208", "PROCNT": "203", "FAT": "204", "CHOCDF": "205", "FIBTG": "291", "SUGAR": "269",
    "FASAT": "606", "FAMS": "645", "FAPU": "646", "FATRN": "605", "CHOLE": "601", "ALC": "221", "CAFFN": "262",
    "CA": "301", "FE": "303", "MG": "304", "P": "305", "K": "306", "NA": "307", "ZN": "309", "CU": "312", "MN": "315",
    "SE": "317", "VITC": "401", "THIA": "404", "RIBF": "405", "NIA": "406", "PANTAC": "410", "VITB6A": "415",
    "FOL": "417", "FOLAC": "431", "FOLDFE": "435", "VITB12": "418", "VITA_RAE": "320", "RETOL": "319", "CARTB": "321",
    "TOCPHA": "323", "VITD": "328", "VITK1": "430",
}  # fmt: skip
CUT_NAMES = "UPDATE food SET name = substr(name, 1, 200)"
CUT_VERSIONS = "UPDATE food SET key = substr(key, 1, 85) || '#' || id WHERE superseded_by_id IS NOT NULL"
CUT_CHECKSUMS = """
    UPDATE food_release SET checksum = 'cut ' || id || ' ' || substr(checksum, 1, 40)
    WHERE id IN (
        SELECT release_id FROM food_posting
        UNION SELECT f.release_id FROM food f JOIN food_code c ON c.food_id = f.id
    )
"""
FROM_PORTIONS = ("portion", "related", "group")


def upgrade() -> None:
    connection = op.get_bind()
    key_components_by_number(connection)
    alter_releases(connection)
    alter_foods(connection)
    create_food_tables()
    create_search_tables()
    create_item_food(connection)
    list_releases_of_runs(connection)


def downgrade() -> None:
    """Only the starter table stays in force. Of what was imported the foods stay, for the records that name them."""
    connection = op.get_bind()
    fit_into_first_tables(connection)
    for table in (
        "item_food", "recompute", "food_code", "food_posting", "food_word_trigram", "food_word", "study_density",
        "food_change", "food_ingredient", "food_portion",
    ):  # fmt: skip
        op.drop_table(table)
    with op.batch_alter_table("run") as batch_op:
        batch_op.drop_column("food_releases")
        batch_op.add_column(sa.Column("food_release_id", sa.Integer(), nullable=True))
        batch_op.create_foreign_key(
            op.f("fk_run_food_release_id_food_release"), "food_release", ["food_release_id"], ["id"]
        )
    with op.batch_alter_table("food_density") as batch_op:
        batch_op.drop_constraint(op.f("ck_food_density_weighs"), type_="check")
        batch_op.drop_column("weighs")
    with op.batch_alter_table("food") as batch_op:
        batch_op.drop_constraint(op.f("fk_food_superseded_by_id_food"), type_="foreignkey")
        batch_op.drop_constraint(op.f("uq_food_release_id_key_version"), type_="unique")
        for index in ("ix_food_superseded_by_id", "ix_food_key", "ix_food_release_id_food_group"):
            batch_op.drop_index(index)
        for column in ("version", "state", "is_mixed_dish", "probes", "recipe_yield", "superseded_by_id"):
            batch_op.drop_column(column)
        batch_op.alter_column("name", existing_type=sa.String(length=300), type_=sa.String(length=200))
        batch_op.create_unique_constraint(op.f("uq_food_release_id_key"), ["release_id", "key"])
    with op.batch_alter_table("food_release") as batch_op:
        batch_op.add_column(sa.Column("is_active", sa.Boolean(), nullable=False, server_default=sa.false()))
        for column in ("source", "importer_id", "written_at", "completed_at"):
            batch_op.drop_column(column)
    connection.execute(
        sa.text(
            "UPDATE food_release SET is_active = :yes WHERE id = (SELECT a.release_id FROM food_activation a "
            "JOIN food_release r ON r.id = a.release_id WHERE r.name = 'tada-starter' ORDER BY a.id DESC LIMIT 1)"
        ),
        {"yes": True},
    )
    with op.batch_alter_table("food_release") as batch_op:
        batch_op.alter_column("is_active", existing_type=sa.Boolean(), server_default=None)
    op.drop_table("food_activation")
    key_components_by_tagname(connection)


def fit_into_first_tables(connection: sa.Connection) -> None:
    """What the first tables' widths and constraints refuse is cut: long names, several versions of a food.

    A release loses its portions, codes, index and some components, so it is no longer the files that its checksum
    names: without that, importing them again would find it there and mend nothing.
    """
    for statement in (CUT_NAMES, CUT_VERSIONS, CUT_CHECKSUMS):
        connection.execute(sa.text(statement))


def key_components_by_number(connection: sa.Connection) -> None:
    components = connection.execute(sa.text("SELECT tagname, name, unit FROM component")).all()
    contents = connection.execute(sa.text("SELECT food_id, tagname, per_100_g FROM food_nutrient")).all()
    op.drop_table("food_nutrient")
    op.drop_table("component")
    component = op.create_table(
        "component",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("number", sa.String(length=16), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("unit", sa.String(length=8), nullable=False),
        sa.Column("tagname", sa.String(length=16), nullable=True),
        sa.Column("expression", sa.String(length=100), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_component")),
        sa.UniqueConstraint("number", name=op.f("uq_component_number")),
    )
    nutrient = op.create_table(
        "food_nutrient",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("component_id", sa.Integer(), nullable=False),
        sa.Column("per_100_g", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["component_id"], ["component.id"], name=op.f("fk_food_nutrient_component_id_component")
        ),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_nutrient_food_id_food")),
        sa.PrimaryKeyConstraint("food_id", "component_id", name=op.f("pk_food_nutrient")),
    )
    if components:
        rows = [
            {"number": NUMBERS[c.tagname], "name": c.name, "unit": c.unit, "tagname": c.tagname} for c in components
        ]
        connection.execute(sa.insert(component), rows)
    ids = {row.tagname: row.id for row in connection.execute(sa.select(component.c.tagname, component.c.id))}
    if contents:
        connection.execute(
            sa.insert(nutrient),
            [{"food_id": c.food_id, "component_id": ids[c.tagname], "per_100_g": c.per_100_g} for c in contents],
        )


def key_components_by_tagname(connection: sa.Connection) -> None:
    """Back to the first migration's tables: what they cannot hold, components without such a tagname, goes."""
    numbers = list(NUMBERS.values())
    component = sa.table("component", *map(sa.column, ("id", "number", "name", "unit", "tagname")))
    nutrient = sa.table("food_nutrient", *map(sa.column, ("food_id", "component_id", "per_100_g")))
    components = connection.execute(sa.select(component).where(component.c.number.in_(numbers))).all()
    tagnames = {row.id: row.tagname for row in components}
    contents = connection.execute(sa.select(nutrient).where(nutrient.c.component_id.in_(list(tagnames)))).all()
    op.drop_table("food_nutrient")
    op.drop_table("component")
    old_component = op.create_table(
        "component",
        sa.Column("tagname", sa.String(length=16), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("unit", sa.String(length=8), nullable=False),
        sa.PrimaryKeyConstraint("tagname", name=op.f("pk_component")),
    )
    old_nutrient = op.create_table(
        "food_nutrient",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("tagname", sa.String(length=16), nullable=False),
        sa.Column("per_100_g", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_nutrient_food_id_food")),
        sa.ForeignKeyConstraint(["tagname"], ["component.tagname"], name=op.f("fk_food_nutrient_tagname_component")),
        sa.PrimaryKeyConstraint("food_id", "tagname", name=op.f("pk_food_nutrient")),
    )
    if components:
        rows = [{"tagname": c.tagname, "name": c.name[:100], "unit": c.unit} for c in components]
        connection.execute(sa.insert(old_component), rows)
    if contents:
        connection.execute(
            sa.insert(old_nutrient),
            [{"food_id": c.food_id, "tagname": tagnames[c.component_id], "per_100_g": c.per_100_g} for c in contents],
        )


def alter_releases(connection: sa.Connection) -> None:
    activation = op.create_table(
        "food_activation",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("release_id", sa.Integer(), nullable=True),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("activated_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(
            ["release_id"], ["food_release.id"], name=op.f("fk_food_activation_release_id_food_release")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_food_activation")),
    )
    op.create_index("ix_food_activation_name_id", "food_activation", ["name", "id"])
    active = connection.execute(
        sa.text("SELECT id, name, imported_at FROM food_release WHERE is_active").columns(imported_at=INSTANT)
    ).all()
    if active:
        connection.execute(
            sa.insert(activation),
            [
                {"name": row.name, "release_id": row.id, "author": "migration", "activated_at": row.imported_at}
                for row in active
            ],
        )
    with op.batch_alter_table("food_release") as batch_op:
        batch_op.add_column(sa.Column("source", sa.String(length=32), nullable=False, server_default="starter"))
        batch_op.add_column(sa.Column("importer_id", sa.Uuid(), nullable=True))
        batch_op.add_column(sa.Column("written_at", INSTANT, nullable=True))
        batch_op.add_column(sa.Column("completed_at", INSTANT, nullable=True))
        batch_op.drop_column("is_active")
    connection.execute(sa.text("UPDATE food_release SET completed_at = imported_at"))
    with op.batch_alter_table("food_release") as batch_op:
        batch_op.alter_column("source", existing_type=sa.String(length=32), server_default=None)


def alter_foods(connection: sa.Connection) -> None:
    with op.batch_alter_table("food") as batch_op:
        batch_op.drop_constraint(op.f("uq_food_release_id_key"), type_="unique")
        batch_op.add_column(sa.Column("version", sa.Integer(), nullable=False, server_default="1"))
        batch_op.add_column(sa.Column("state", sa.String(length=16), nullable=True))
        batch_op.add_column(sa.Column("is_mixed_dish", sa.Boolean(), nullable=False, server_default=sa.false()))
        batch_op.add_column(sa.Column("probes", JSON_VALUE, nullable=False, server_default="[]"))
        batch_op.add_column(sa.Column("recipe_yield", sa.Double(), nullable=True))
        batch_op.add_column(sa.Column("superseded_by_id", sa.Integer(), nullable=True))
        batch_op.alter_column("name", existing_type=sa.String(length=200), type_=sa.String(length=300))
        batch_op.create_unique_constraint(op.f("uq_food_release_id_key_version"), ["release_id", "key", "version"])
        batch_op.create_foreign_key(op.f("fk_food_superseded_by_id_food"), "food", ["superseded_by_id"], ["id"])
        batch_op.create_index("ix_food_superseded_by_id", ["superseded_by_id"])
        batch_op.create_index("ix_food_key", ["key"])
        batch_op.create_index("ix_food_release_id_food_group", ["release_id", "food_group"])
    with op.batch_alter_table("food") as batch_op:
        for column, kind in (("version", sa.Integer()), ("is_mixed_dish", sa.Boolean()), ("probes", JSON_VALUE)):
            batch_op.alter_column(column, existing_type=kind, server_default=None)
    with op.batch_alter_table("food_density") as batch_op:
        batch_op.add_column(sa.Column("weighs", sa.String(length=8), nullable=False, server_default="as_seen"))
        batch_op.create_check_constraint(op.f("ck_food_density_weighs"), "weighs IN ('as_seen', 'edible')")
    density = sa.table("food_density", *map(sa.column, ("basis", "kind", "weighs")))
    connection.execute(
        sa.update(density).where(density.c.kind == "bulk", density.c.basis.in_(FROM_PORTIONS)).values(weighs="edible")
    )
    with op.batch_alter_table("food_density") as batch_op:
        batch_op.alter_column("weighs", existing_type=sa.String(length=8), server_default=None)


def create_food_tables() -> None:
    op.create_table(
        "food_portion",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("sequence", sa.String(length=32), nullable=False),
        sa.Column("amount", sa.Double(), nullable=False),
        sa.Column("measure", sa.String(length=200), nullable=False),
        sa.Column("mass_g", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_portion_food_id_food")),
        sa.PrimaryKeyConstraint("food_id", "position", name=op.f("pk_food_portion")),
    )
    op.create_table(
        "food_ingredient",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("ingredient_id", sa.Integer(), nullable=False),
        sa.Column("mass_g", sa.Double(), nullable=False),
        sa.Column("retention", JSON_VALUE, nullable=False),
        sa.Column("retention_source", sa.String(length=300), nullable=True),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_ingredient_food_id_food")),
        sa.ForeignKeyConstraint(["ingredient_id"], ["food.id"], name=op.f("fk_food_ingredient_ingredient_id_food")),
        sa.PrimaryKeyConstraint("food_id", "position", name=op.f("pk_food_ingredient")),
    )
    op.create_index("ix_food_ingredient_ingredient_id", "food_ingredient", ["ingredient_id"])
    op.create_table(
        "food_change",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("previous_id", sa.Integer(), nullable=True),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("differences", JSON_VALUE, nullable=False),
        sa.Column("changed_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_change_food_id_food")),
        sa.ForeignKeyConstraint(["previous_id"], ["food.id"], name=op.f("fk_food_change_previous_id_food")),
        sa.PrimaryKeyConstraint("food_id", name=op.f("pk_food_change")),
    )
    op.create_index("ix_food_change_previous_id", "food_change", ["previous_id"])
    op.create_table(
        "study_density",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("food_key", sa.String(length=100), nullable=False),
        sa.Column("g_per_ml", sa.Double(), nullable=False),
        sa.Column("sd_g_per_ml", sa.Double(), nullable=False),
        sa.Column("state", sa.String(length=32), nullable=False),
        sa.Column("kind", sa.String(length=8), nullable=False),
        sa.Column("weighs", sa.String(length=8), nullable=False),
        sa.Column("source", sa.String(length=300), nullable=False),
        sa.Column("specimens", JSON_VALUE, nullable=True),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("measured_at", INSTANT, nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.Column("withdrawn_by", sa.String(length=200), nullable=True),
        sa.Column("withdrawn_at", INSTANT, nullable=True),
        sa.Column("withdrawal_reason", sa.Text(), nullable=True),
        sa.CheckConstraint("kind IN ('solid', 'bulk')", name=op.f("ck_study_density_kind")),
        sa.CheckConstraint("weighs IN ('as_seen', 'edible')", name=op.f("ck_study_density_weighs")),
        sa.CheckConstraint("g_per_ml > 0", name=op.f("ck_study_density_positive")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_study_density_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study_density")),
    )
    op.create_index("ix_study_density_study_id_food_key", "study_density", ["study_id", "food_key"])


def create_search_tables() -> None:
    op.create_table(
        "food_code",
        sa.Column("system", sa.String(length=32), nullable=False),
        sa.Column("code", sa.String(length=300), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_code_food_id_food")),
        sa.PrimaryKeyConstraint("system", "code", "food_id", name=op.f("pk_food_code")),
    )
    op.create_index("ix_food_code_food_id", "food_code", ["food_id"])
    op.create_index("ix_food_code_code", "food_code", ["code"])
    op.create_table(
        "food_word",
        sa.Column("word", WORD, nullable=False),
        sa.PrimaryKeyConstraint("word", name=op.f("pk_food_word")),
    )
    op.create_table(
        "food_word_trigram",
        sa.Column("trigram", TRIGRAM, nullable=False),
        sa.Column("word", WORD, nullable=False),
        sa.ForeignKeyConstraint(["word"], ["food_word.word"], name=op.f("fk_food_word_trigram_word_food_word")),
        sa.PrimaryKeyConstraint("trigram", "word", name=op.f("pk_food_word_trigram")),
    )
    op.create_table(
        "food_posting",
        sa.Column("word", WORD, nullable=False),
        sa.Column("rank", sa.Integer(), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("release_id", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_posting_food_id_food")),
        sa.PrimaryKeyConstraint("word", "rank", "food_id", "release_id", name=op.f("pk_food_posting")),
        sqlite_with_rowid=False,
    )
    op.create_index("ix_food_posting_food_id_word", "food_posting", ["food_id", "word"])


def create_item_food(connection: sa.Connection) -> None:
    op.create_table(
        "recompute",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("food_releases", JSON_VALUE, nullable=False),
        sa.Column("started_at", INSTANT, nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_recompute")),
    )
    item_food = op.create_table(
        "item_food",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("lies_as", sa.String(length=16), nullable=True),
        sa.Column("density_g_per_ml", sa.Double(), nullable=True),
        sa.Column("density_sd_g_per_ml", sa.Double(), nullable=True),
        sa.Column("density_state", sa.String(length=32), nullable=True),
        sa.Column("density_kind", sa.String(length=8), nullable=True),
        sa.Column("density_basis", sa.String(length=32), nullable=True),
        sa.Column("density_source", sa.String(length=300), nullable=True),
        sa.Column("density_weighs", sa.String(length=8), nullable=True),
        sa.Column("edible_share", sa.Double(), nullable=False),
        sa.Column("recompute_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_item_food_food_id_food")),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_item_food_item_id_item")),
        sa.ForeignKeyConstraint(["recompute_id"], ["recompute.id"], name=op.f("fk_item_food_recompute_id_recompute")),
        sa.PrimaryKeyConstraint("item_id", "version", name=op.f("pk_item_food")),
    )
    records = connection.execute(
        sa.text(
            "SELECT r.item_id AS item_id, r.food_id AS food_id, r.density_g_per_ml AS density_g_per_ml, "
            "d.sd_g_per_ml AS density_sd_g_per_ml, d.state AS density_state, d.kind AS density_kind, "
            "d.basis AS density_basis, r.density_source AS density_source, f.refuse AS refuse, "
            "r.mass_g AS mass_g, r.edible_g AS edible_g, n.created_at AS created_at "
            "FROM effective_record r JOIN food f ON f.id = r.food_id JOIN item i ON i.id = r.item_id "
            "JOIN run n ON n.id = i.run_id "
            "LEFT JOIN food_density d ON d.food_id = r.food_id AND d.source = r.density_source "
            "AND d.g_per_ml = r.density_g_per_ml"
        ).columns(item_id=sa.Uuid(), refuse=JSON_VALUE, created_at=INSTANT)
    ).mappings()
    rows = {row["item_id"]: item_food_of(dict(row)) for row in records}  # a source may give a density twice
    if rows:
        connection.execute(sa.insert(item_food), list(rows.values()))


def list_releases_of_runs(connection: sa.Connection) -> None:
    """A run was made with one release; from here on several may be in force at once."""
    with op.batch_alter_table("run") as batch_op:
        batch_op.add_column(sa.Column("food_releases", JSON_VALUE, nullable=False, server_default="[]"))
    run = sa.table("run", sa.column("food_release_id"), sa.column("food_releases", JSON_VALUE))
    for release in connection.execute(sa.text("SELECT id, name, version FROM food_release")).all():
        connection.execute(
            sa.update(run)
            .where(run.c.food_release_id == release.id)
            .values(food_releases=[f"{release.name} {release.version}"])
        )
    with op.batch_alter_table("run") as batch_op:
        batch_op.alter_column("food_releases", existing_type=JSON_VALUE, server_default=None)
        batch_op.drop_constraint(op.f("fk_run_food_release_id_food_release"), type_="foreignkey")
        batch_op.drop_column("food_release_id")


def item_food_of(record: dict[str, object]) -> dict[str, object]:
    """What a record was weighed with. Its density weighed what was seen: nothing else was known then."""
    mass_g, edible_g, refuse = record.pop("mass_g"), record.pop("edible_g"), record.pop("refuse")
    share = edible_g / mass_g if mass_g else share_of(refuse)  # type: ignore[operator]
    weighs = "as_seen" if record["density_g_per_ml"] is not None else None
    return record | {"version": 1, "density_weighs": weighs, "edible_share": share}


def share_of(refuse: list[dict[str, object]]) -> float:
    refused = sum(float(part["percent"]) for part in refuse)  # type: ignore[arg-type]
    absent = sum(float(part["percent"]) for part in refuse if not part["is_served"])  # type: ignore[arg-type]
    return (100.0 - refused) / (100.0 - absent)
