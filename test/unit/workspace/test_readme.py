"""The README and the pages show what is there: examples, documents and targets."""

from __future__ import annotations

import re

import pytest

from support.workspace import REPOSITORY

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
PAGES = [README, *(page.read_text("utf-8") for page in sorted(REPOSITORY.glob("docs/*.md")))]
EXAMPLE = re.compile(r"<!-- example: (\S+) -->\n```\w+\n(.*?)```", re.DOTALL)
EXAMPLES = [shown for page in PAGES for shown in EXAMPLE.findall(page)]


def test_the_readme_shows_examples() -> None:
    assert len(EXAMPLES) >= 3


@pytest.mark.parametrize(("path", "shown"), EXAMPLES)
def test_examples_that_are_shown_are_the_files(path: str, shown: str) -> None:
    assert shown.strip() == (REPOSITORY / path).read_text(encoding="utf-8").strip()


@pytest.mark.parametrize("target", sorted(set(re.findall(r"\]\(([^)#]+)\)", README))))
def test_links_of_the_readme_lead_somewhere(target: str) -> None:
    if not target.startswith(("http:", "https:")):
        assert (REPOSITORY / target).exists()


@pytest.mark.parametrize("target", sorted(set(re.findall(r"^make (\w+)", README, re.MULTILINE))))
def test_make_targets_in_the_readme_exist(target: str) -> None:
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}:", makefile, re.MULTILINE)
