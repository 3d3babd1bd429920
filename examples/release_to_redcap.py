"""A release's participants and days for REDCap: `python release_to_redcap.py FOLDER`, which has the release's files.

Writes redcap_dictionary.csv (Project Setup, Data Dictionary) and redcap_import.csv (Data Import Tool). Between the two,
make the instrument `day` a repeating one (Project Setup, Repeatable instruments).
"""

import csv
import json
import sys
from datetime import date
from pathlib import Path

HEAD = [
    "Variable / Field Name", "Form Name", "Section Header", "Field Type", "Field Label",
    "Choices, Calculations, OR Slider Labels", "Field Note", "Text Validation Type OR Show Slider Number",
    "Text Validation Min", "Text Validation Max", "Identifier?", "Branching Logic (Show field only if...)",
    "Required Field?", "Custom Alignment", "Question Number (surveys only)", "Matrix Group Name", "Matrix Ranking?",
    "Field Annotation",
]  # fmt: skip
VALIDATION = {"day": "date_ymd", "integer": "integer", "number": "number"}
KEYS = ["record_id", "redcap_repeat_instrument", "redcap_repeat_instance"]
FORMS = {"participants": "participant", "days": "day"}
FIRST = date(1999, 12, 31)  # a day keeps its number of instance in every release
OF_RECORD = ("study", "participant")  # the same for each row of a record


def field(column, form):
    """A line of the dictionary."""
    line = dict.fromkeys(HEAD, "") | {
        "Variable / Field Name": column["name"],
        "Form Name": form,
        "Field Type": "text",
    }
    line |= {"Field Label": column["meaning"] or column["name"], "Field Note": column["unit"] or ""}
    if column["type"] == "boolean":
        line["Field Type"] = "truefalse"
    elif column["values"]:
        line["Field Type"] = "dropdown"
        line[HEAD[5]] = " | ".join(f"{value}, {value}" for value in column["values"])
    else:
        line[HEAD[7]] = VALIDATION.get(column["type"], "")
    return line


def value(text, column):
    """A cell, as REDCap has it."""
    return {"True": 1, "False": 0, "": ""}[text] if column["type"] == "boolean" else text


def write(path, head, rows):
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, head, restval="")
        writer.writeheader()
        writer.writerows(rows)


def main(folder):
    tables = json.loads((folder / "datapackage.json").read_text(encoding="utf-8"))["tada"]["tables"]
    record_id = {
        "name": "record_id",
        "type": "word",
        "unit": None,
        "values": [],
        "meaning": "Participant",
    }
    fields, rows = [field(record_id, "participant")], []
    for table, form in FORMS.items():
        columns = [column for column in tables[table] if column["name"] not in OF_RECORD]
        fields += [field(column, form) for column in columns]
        with (folder / f"{table}.csv").open(newline="", encoding="utf-8") as file:
            for cells in csv.DictReader(file):
                row = {"record_id": cells["participant"]}
                if form == "day":
                    number = (date.fromisoformat(cells["local_date"]) - FIRST).days
                    row |= {KEYS[1]: form, KEYS[2]: number}
                row |= {column["name"]: value(cells[column["name"]], column) for column in columns}
                rows.append(row)
    write(folder / "redcap_dictionary.csv", HEAD, fields)
    write(folder / "redcap_import.csv", [*KEYS, *(line[HEAD[0]] for line in fields[1:])], rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
