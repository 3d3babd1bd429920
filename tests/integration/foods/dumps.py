"""Open Food Facts' dump in small: rows of a few columns, the others as published."""

import gzip

COCOA = {
    "code": "3017620422003",
    "product_name": "Cocoa spread",
    "brands": "Ferrero",
    "quantity": "400 g",
    "serving_size": "15 g",
    "serving_quantity": "15",
    "countries_tags": "en:france,en:germany",
    "last_modified_t": "1700000000",
    "nutrition_data_per": "100g",
    "energy-kj_100g": "2252",
    "energy-kcal_100g": "539",
    "energy_100g": "2252",
    "fat_100g": "30.9",
    "saturated-fat_100g": "10.6",
    "carbohydrates_100g": "57.5",
    "sugars_100g": "56.3",
    "fiber_100g": "",
    "proteins_100g": "6.3",
    "salt_100g": "0.107",
    "sodium_100g": "0.0428",
    "energy-kcal_serving": "",
    "fat_serving": "",
    "carbohydrates_serving": "",
    "proteins_serving": "",
    "polyols_100g": "",
}
NO_LABEL = {name: "" for name in COCOA if name.endswith(("_100g", "_serving"))}


def write_dump(path, *rows, columns=tuple(COCOA)):
    """Write rows, each as changes of COCOA, and return the path."""
    lines = ["\t".join(columns)]
    lines += ["\t".join((COCOA | row)[name] for name in columns) for row in rows]
    text = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
    return path
