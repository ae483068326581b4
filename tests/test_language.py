"""The wording of all texts: docs, notebooks, docstrings, comments, messages, names of tests.

The patterns are phrases that were replaced by plain technical English, and their kind.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("sfmkit", "tests", "benchmarks", "docs", "notebooks", ".ci")
SUFFIXES = {".py", ".js", ".md", ".ipynb", ".json", ".toml", ".yaml", ""}

_THING = "core|cell|image|pair|operator|match|stage|scene|sequence|worker|keypoint|photograph"

#: replaced phrase -> a text that contains it
PATTERNS = {
    r"\bgoes? on where\b": "the same command goes on where it stopped",
    r"\bgone on with\b": "Interrupted downloads are gone on with",
    r"\bhow sure\b": "How sure a pose and its points are",
    r"\bto be had\b": "there is no depth to be had",
    r"\bof one thing\b": "Two clouds of one thing",
    r"\b(broke|breaks?|broken) off\b": "Run again it broke off",
    r"\b(is|are|was|were) told\b": "the worker is told the budget",
    r"\bknows? (no|of|only)\b": "peers know no skew",
    rf"\b(one|an?) [a-z]+ an? ({_THING})\b": "one thread a core",
    r"(?<![tT]here )\b(is|are) no (?!longer\b|more\b|other\b)[a-z]+": "R is no rotation",
    r"\bthe other way about\b": "The other way about",
    r"\bgoes nowhere\b": "triangulates at the given pose and goes nowhere",
    r"\bword to (itself|whoever)\b": "and a word to whoever watches",
    r"\bwhere a homography says to look\b": "Matching again where a homography says to look",
    r"\bstands? (neither|which)\b": "it stands neither rotation nor zoom",
    r"\bdetector stands\b": "which detector stands which change",
    r"\blies? wrongly\b": "warning: B may lie wrongly",
    r"\btoo little has a partner\b": "or too little has a partner",
    r"\bdifferentia(te|ted|ble) [a-z]+ by\b": "differentiate it by the pixels",
    r"\bdegrees of freedom has\b": "How many degrees of freedom has F?",
    r"\bbrought together\b": "Two clouds brought together",
    r"\bwhat is to be had\b": "what is to be had",
    r"\ball there is to\b": "its outline is all there is to find",
    r"\bkeeps? its promise\b": "whether it keeps its promise",
    r"\bhangs? on\b": "Which matches does the pose hang on",
}


#: packages in which the docstring of every function starts with an imperative sentence on one line
IMPERATIVE = ("_utils", "features", "geometry", "matching", "pipeline", "teaching", "types")
NOT_VERBS = {
    *("A", "An", "The", "Every", "All", "One", "Those", "Its", "Of", "With", "For"),
    *("What", "Whether", "Where", "Which", "How"),
}


def files() -> list[Path]:
    found = [p for folder in FOLDERS for p in (ROOT / folder).rglob("*") if p.is_file()]
    found += [p for p in ROOT.iterdir() if p.is_file() and p.name not in ("LICENSE", ".git")]
    return sorted(
        p
        for p in found
        if p.suffix in SUFFIXES
        and p != Path(__file__)
        and not {"__pycache__", "api", "_build", ".ipynb_checkpoints"} & set(p.parts)
    )


def text_of(path: Path) -> str:
    """The text of a file on one line, without comment marks and without breaks of strings."""
    text = path.read_text(encoding="utf-8", errors="ignore")
    if path.suffix == ".ipynb":
        text = "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])
    text = re.sub(r"\n\s*#+ ?", " ", text)
    text = re.sub(r"[\"']\s*\n\s*[rf]?[\"']", "", text)
    return re.sub(r"[\s_]+", " ", text)


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    return {str(path.relative_to(ROOT)): text_of(path) for path in files()}


@pytest.mark.parametrize(("pattern", "example"), PATTERNS.items(), ids=list(PATTERNS))
def test_a_replaced_phrase_does_not_occur(texts, pattern, example):
    assert re.search(pattern, example, re.IGNORECASE)
    assert len(texts) > 200
    found = [
        f"{name}: ...{text[max(0, m.start() - 60) : m.end() + 40]}..."
        for name, text in texts.items()
        for m in re.finditer(pattern, text, re.IGNORECASE)
    ]
    assert not found, "\n".join(found)


def functions(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the place and the docstring of every function that is not a property."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            decorators = {getattr(d, "id", "") for d in node.decorator_list}
            text = ast.get_docstring(node)
            if text and not decorators & {"property", "cached_property"}:
                yield f"{path.relative_to(ROOT)}:{node.lineno}", text


@pytest.mark.parametrize("package", IMPERATIVE)
def test_docstrings_of_functions_start_with_an_imperative_sentence_on_one_line(package):
    found = [
        f"{place}: {text.splitlines()[0]}"
        for path in sorted((ROOT / "sfmkit" / package).rglob("*.py"))
        for place, text in functions(path)
        if "\n" in text.partition("\n\n")[0]
        or not text.split()[0].isalpha()
        or text.split()[0] in NOT_VERBS
    ]
    assert not found, "\n".join(found)
