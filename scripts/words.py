"""Measure the prose of the pages: lengths of sentences, numbers in a sentence, words that are not said here.

A page's prose is its text without code, tables, folded parts, pictures and the marks of claims. The rules stand in
.ci/words.toml. `make lint` runs it; every fault is printed with its file and line.

Run: python scripts/words.py [--json FILE]
"""

import json
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RULES: Mapping[str, Any] = tomllib.loads((ROOT / ".ci/words.toml").read_text(encoding="utf-8"))
BLANKED = (
    r"\A---\n.*?\n---\n",  # front matter
    r"^( *)(```+|~~~+).*?^\1\2",  # code
    r"<details.*?</details>",
    r"<svg.*?</svg>|<script.*?</script>|<style.*?</style>",
    r"<!--.*?-->",
    r"^ *\|.*?$",  # rows of tables
    r"^#.*?$",  # headings
    r"!\[[^\]]*\]\([^)]*\)",
    r"<[a-zA-Z/][^>\n]*>",
    r"(?<=\])\([^)\s]*\)",  # targets of links
    r"^\[[^\]]+\]: .*?$",
)
NAMED = r"(?:Table|Figure|Section|seed|Agronomy|Python) [\d:]+|#\d+|\b(?:19|20)\d\d\b"
NUMBER = r"(?<![\w.+-])[-−+]?\d[\d.,]*(?:\s(?=\d{3}\b)\d{3})*"

SENTENCE = r"\S.*?(?:[.!?:](?=[\s\"”)*]+(?:[^a-z\s]|pickenv|macOS)|\s*\Z)|\Z)"
NEAR = 250
"""Characters after a name within which it may be spelled out."""


def pages() -> list[Path]:
    """The pages that people read: those of the root, and all of docs but what is made of docstrings."""
    docs = (path for path in sorted((ROOT / "docs").rglob("*.md")) if not {"_build", "_generated"} & set(path.parts))
    return [*(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING", "SECURITY")), *docs]


def blanked(text: str, patterns: Iterable[str]) -> str:
    """A text with what patterns match blanked, line for line."""
    for pattern in patterns:
        text = re.sub(pattern, lambda match: re.sub(r"[^\n]", " ", match[0]), text, flags=re.DOTALL | re.MULTILINE)
    return text


def prose(text: str) -> str:
    """A page's text with all that is no prose blanked, line for line."""
    return re.sub(r"`+([^`\n]*)`+", lambda match: re.sub(r"[^\n]", "X", match[0]), blanked(text, BLANKED))


def sentences(text: str) -> Iterator[tuple[int, str]]:
    """Line (from 1) and words of each sentence, without intervals; an item of a list ends one, too."""
    begin = r"^ *(?:#+|[-*>]|\d+\.|:::+.*$|:\w+:.*$) *|\n\s*\n"
    text = prose(text)
    for block in re.finditer(rf"(?:(?!{begin}).)+", text, flags=re.DOTALL | re.MULTILINE):
        for part in re.finditer(SENTENCE, block[0], flags=re.DOTALL):
            line = text.count("\n", 0, block.start() + part.start()) + 1
            yield line, " ".join(re.sub(r"\([-+\d.]+ to [-+\d.]+\)", "", part[0]).strip("*_ ").split())


def faults(text: str) -> Iterator[tuple[int, str, str]]:
    """Line, sentence and what is wrong with it, of every sentence that breaks a rule."""
    for line, sentence in sentences(text):
        if (count := len(sentence.split())) > RULES["most_words"]:
            yield line, sentence, f"has {count} words; say it in two sentences of at most {RULES['most_words']}"
        numbers = re.findall(rf"{NUMBER}(?: (?:to|of) {NUMBER})?", re.sub(NAMED, "", sentence))
        if len(numbers) > RULES["most_numbers"]:
            yield line, sentence, f"has {len(numbers)} numbers; leave {RULES['most_numbers']}, or make a table"
        for pattern, instead in RULES["banned"].items():
            if (match := re.search(pattern, sentence)) is not None:
                yield line, sentence, f"says '{match[0]}'; {instead}"


def unexplained(text: str) -> Iterator[tuple[int, str, str]]:
    """Line, name and what to do of every name that is not spelled out where it first stands on a page."""
    text = blanked(text, (BLANKED[1], BLANKED[4]))
    for name, spelled in RULES["names"].items():
        first = re.search(name, text)
        if first is not None and re.search(spelled, text[: first.end() + NEAR]) is None:
            yield text.count("\n", 0, first.start()) + 1, first[0], f"stands without '{spelled}' before or beside it"


def measures(text: str) -> dict[str, float]:
    """Words and sentences of a page, and the mean length of a sentence in words."""
    lengths = [len(sentence.split()) for _, sentence in sentences(text) if re.search(r"[a-z]{2}", sentence)]
    return {"words": sum(lengths), "sentences": len(lengths), "mean": sum(lengths) / max(len(lengths), 1)}


def main() -> int:
    """Print every fault; 1 if there is one."""
    bad, figures = 0, {}
    for path in pages():
        name, text = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
        figures[name] = measures(text)
        for line, sentence, why in (*faults(text), *unexplained(text)):
            bad += 1
            print(f"{name}:{line}: '{sentence[:70]}…' {why}")
        if figures[name]["mean"] >= RULES["mean_words"]:
            bad += 1
            print(f"{name}: sentences have {figures[name]['mean']:.1f} words in the mean; below {RULES['mean_words']}")
    if "--json" in sys.argv:
        Path(sys.argv[-1]).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    words = sum(page["words"] for page in figures.values())
    bad += words > RULES["most_in_all"]
    print(f"{words:.0f} words on {len(figures)} pages (at most {RULES['most_in_all']}), {bad} faults")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
