"""One version in all files that name it, and the same dependencies wherever they are listed."""

import re
import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
VERSION = PROJECT["version"]


def name_of(requirement: str) -> str:
    """The name in a requirement such as `tomli; python_version < '3.11'`."""
    return re.match(r"[\w-]+", requirement)[0].lower()


def test_the_newest_version_of_the_changes_is_that_of_the_project():
    named = re.findall(r"^## (\d\S*)(?: \((\d{4}-\d\d-\d\d)\))?$", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)
    assert named[0][0] == VERSION
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {VERSION}\n" in citation
    assert f"\ndate-released: {named[0][1]}\n" in citation


def test_the_citation_has_what_its_format_demands():
    citation = (ROOT / "CITATION.cff").read_text()
    for field in ("cff-version", "message", "title", "authors"):
        assert re.search(rf"^{field}:", citation, flags=re.M), field
    assert re.search(r"^license: (.*)$", citation, flags=re.M)[1] == PROJECT["license"]


def test_the_conda_recipe_has_the_projects_version_and_dependencies():
    recipe = (ROOT / "packaging" / "conda-recipe" / "meta.yaml").read_text()
    assert re.search(r'^  version: "(.*)"$', recipe, flags=re.M)[1] == VERSION
    wanted = re.findall(r"^    - ([\w-]+)", recipe.split("  run:\n")[1].split("\ntest:")[0], flags=re.M)
    assert sorted(wanted) == sorted(["python", *map(name_of, PROJECT["dependencies"])])
    assert f"python {PROJECT['requires-python']}" in recipe


def test_the_container_checks_for_the_projects_version():
    assert f'grep -Fx "vpp {VERSION}"' in (ROOT / "packaging" / "Dockerfile").read_text()


def test_the_installation_page_names_the_wheel_and_the_extras():
    page = (ROOT / "docs" / "install.md").read_text()
    assert set(re.findall(r"vpp_fmu-(\d[\d.]*\d)-py3", page)) == {VERSION}
    internal = {"test", "docs", "release", "interop", "benchmarks"}
    assert set(re.findall(r"^\| `(\w+)` \|", page, flags=re.M)) == set(PROJECT["optional-dependencies"]) - internal
