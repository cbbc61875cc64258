"""What people ask, taken apart: a small grammar, the same for all, without a language model.

    query = thing [relation query]
    thing = [colour] name {", not" name}

`relation` and `colour` are the words of `relations.WORDS` and of `attributes`; articles may stand
before a thing. So a relation binds to all that follows: "cup on table near sofa" looks for a cup on
such a table as is near a sofa. A negative belongs to the thing before it.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

from proground_log.errors import ProgroundError
from proground_log.query.attributes import COLORS, OTHER_WORDS
from proground_log.query.relations import WORDS

_ARTICLES = ("a", "an", "the")
_THINGS_TOO = ("orange",)
"""Names of colours that one may look for by themselves."""
_RELATION = re.compile(rf"(?<!\S)({'|'.join(WORDS)})(?!\S)")
_FORMS = 'ask for instance for "red chair", "chair, not sofa" or "cup on table"'


@dataclass(frozen=True)
class Query:
    """What is looked for.

    Args:
        name: of the thing, as its text is embedded.
        color: one of `attributes.COLORS`, or None for any.
        without: names of what it must not be.
        relation: one of `relations.RELATIONS`, or None.
        other: what it has that relation to; None where there is no relation.
    """

    name: str
    color: str | None = None
    without: tuple[str, ...] = ()
    relation: str | None = None
    other: Query | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All texts that it needs, those of `other` too."""
        return (self.name, *self.without, *(self.other.names if self.other else ()))


def parse_query(text: str, known: Collection[str] = ()) -> Query:
    """Take a question apart.

    Args:
        text: as people write it, in any case, with any spaces.
        known: names in lower case that are one word to the map, whatever words they have: where
            "picture on wall" or "white board" is a prompt of the task, it is that thing.

    Raises:
        ProgroundError: a part is missing, a colour has no thing, "not" stands where nothing comes
            before it, or a colour alone comes after it.

    >>> parse_query("a red cup, not mug, on the table").other
    Query(name='table', color=None, without=(), relation=None, other=None)
    """
    words = " ".join(text.lower().split())
    if not words:
        raise ProgroundError("a text is empty", where="query", todo="leave it out")
    return _query(words, text, known)


def _query(words: str, whole: str, known: Collection[str]) -> Query:
    if _bare(words) in known:
        return Query(_bare(words))
    for match in _RELATION.finditer(words):
        # A relation that is within a known name is none: "cup on picture on wall".
        first = words[: match.start()].strip().removesuffix(",").rstrip()
        if not any(_covers(words, name, match) for name in known):
            thing = _thing(first, whole, known)
            landmark = _query(words[match.end() :].strip(), whole, known)
            return Query(thing.name, thing.color, thing.without, WORDS[match[1]], landmark)
    return _thing(words, whole, known)


def _thing(words: str, whole: str, known: Collection[str]) -> Query:
    """A colour, a name and negatives."""
    first, *rest = (part.strip() for part in words.split(","))
    name, without = _bare(first), []
    for part in rest:
        if not part.startswith("not "):
            raise _fault(f"says {part!r} after a comma, where only 'not' can be", whole)
        without.append(_bare(part.removeprefix("not ")))
        if _is_color(without[-1], known):
            raise _fault(f"says {without[-1]!r} after 'not', where only a thing can be", whole)
    color = None
    word, _, noun = name.partition(" ")
    if name not in known and noun and OTHER_WORDS.get(word, word) in COLORS:
        color, name = OTHER_WORDS.get(word, word), noun
    if not all((name, *without)) or name == "not" or name.startswith("not "):
        raise _fault("has a part that names no thing", whole)
    if _is_color(name, known):
        todo = f'say of what, as in "{name} chair"'
        raise ProgroundError("a colour needs a thing", where=f"query {whole!r}", todo=todo)
    return Query(name, color, tuple(without))


def _is_color(name: str, known: Collection[str]) -> bool:
    """Whether a name is that of a colour, and of no thing."""
    is_thing = name in known or name in _THINGS_TOO
    return OTHER_WORDS.get(name, name) in COLORS and not is_thing


def _bare(words: str) -> str:
    """Without the article before it."""
    word, _, rest = words.partition(" ")
    return rest if word in _ARTICLES and rest else "" if word in _ARTICLES else words


def _covers(words: str, name: str, match: re.Match[str]) -> bool:
    """Whether a relation's words stand within a known name."""
    places = (m.span() for m in re.finditer(rf"(?<!\S){re.escape(name)}(?!\S)", words))
    return any(start <= match.start() and match.end() <= stop for start, stop in places)


def _fault(what: str, whole: str) -> ProgroundError:
    return ProgroundError(what, where=f"query {whole!r}", todo=_FORMS)
