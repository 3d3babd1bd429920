"""The notebooks of examples/, run on a release: their figures are those of the program."""

import json

import pytest

from tests.e2e.processes import REPOSITORY
from tests.integration.diary.eaten_days import add_meal, close, eaten_item, set_profile
from tests.integration.exports.releases.test_releases import fetch, frozen
from tests.integration.people.people import make_staff

DAYS = ("2026-11-20", "2026-11-21")
OWN_KCAL = {"P001": (1500, 1700), "P002": (2100, 1900), "P003": (2500, 2300), "P004": (1800, 2200)}
REFERENCE_KCAL = {"P001": (1400, 1600), "P002": (2300, 2100), "P003": (2600, 2600), "P004": (1700, 1900)}


@pytest.fixture
def release(state, client, admin, enrol, run, tmp_path, monkeypatch):
    """Four people of two closed days, one open day and one without energy, frozen into the folder `baseline`."""
    lines = ["participant,local_date,energy_kcal"]
    for number, (code, amounts) in enumerate(OWN_KCAL.items()):
        phone = enrol(code)
        set_profile(
            state, code, sex="female" if number < 2 else "male", birth_year=1980 + number, weight_kg=60 + number
        )
        for day, own, reference in zip(DAYS, amounts, REFERENCE_KCAL[code], strict=True):
            add_meal(state, code, day, eaten_item(energy_kcal=own))
            close(phone, day)
            lines.append(f"{code},{day},{reference}")
    add_meal(state, "P001", "2026-11-22", eaten_item(energy_kcal=9000))
    add_meal(state, "P004", "2026-11-23", eaten_item(energy_kcal=9000), eaten_item(energy_kcal=None))
    close(phone, "2026-11-23")
    content = "\n".join([*lines, "P001,2026-11-22,1000", "P004,2026-11-23,1000\n"])
    owner = make_staff(client, admin, "olga", pilot="owner")
    made = frozen(owner, run, "baseline")
    (tmp_path / "baseline").mkdir()
    for file in made["files"]:
        (tmp_path / "baseline" / file["name"]).write_bytes(fetch(owner, made, file["name"]))
    (tmp_path / "reference.csv").write_text(content)
    monkeypatch.chdir(tmp_path)
    return content


def run_notebook(name):
    """Run the code cells; what they leave."""
    cells = json.loads((REPOSITORY / "examples" / name).read_text())["cells"]
    left = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), left)
    return left


def test_table_1_has_each_participant_once_by_their_whole_days(release):
    table = run_notebook("table_1.ipynb")["table_1"]
    assert table.loc["participants"].to_dict() == {"all": "4", "female": "2", "male": "2"}
    assert table.loc["energy_kcal"].to_dict() == {
        "all": "2000.0 (326.6), n = 4",
        "female": "1800.0 (282.8), n = 2",
        "male": "2200.0 (282.8), n = 2",
    }
    assert table.loc["weight_kg", "all"] == "61.5 (1.3), n = 4"
    assert table.loc["complete days", "male"] == "2.5 (0.7), n = 2"
    assert table.loc["protein_g", "all"].endswith("n = 0")


def test_agreement_has_the_figures_of_the_program(release, client, admin):
    left = run_notebook("agreement.ipynb")
    path, headers = "/v1/studies/pilot/reference", admin | {"Content-Type": "text/csv"}
    assert client.put(f"{path}-days", headers=headers, content=release.encode()).status_code == 204
    (energy,) = client.get(f"{path}-agreement", headers=admin).json()["items"]
    assert (left["n"], len(left["both"])) == (energy["participants"], energy["days"]) == (4, 8)
    for name, figure in left["figures"].iterrows():
        assert figure.to_dict() == pytest.approx(energy[name]), name
