"""What the site adds to the pages of this folder: pages from elsewhere, links to the repository, and an index of keys.

Links are written for the repository, where most people meet these pages. The site has only some of its files.
"""

from __future__ import annotations

import json
import posixpath
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from markdown.extensions.toc import unique
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from openapi import openapi_document
from pymdownx.slugs import slugify

FROM_ELSEWHERE = {"contributing.md": "CONTRIBUTING.md", "deploy.md": "deploy/README.md"}
"""Pages of the site that are not in this folder, by their path in the repository."""

BEHIND_OTHERS = ("a-z.md", "benchmarks/", "contributing.md", "decisions/")
"""Pages that the search shows after those that explain a word to users, or hold most of its figures."""

FOR_USERS = ("benchmarks/report.md",)
"""Of these, the pages that users want to see first all the same."""

BEFORE_OTHERS = "troubleshooting.md"
"""The page that the search shows first where several have a word: who searches for a symptom wants its remedy."""

INDEX = "a-z.md"
INDEX_MARK = "<!-- index of keys -->"
INDEXED = ("configuration.md", "configuration-rules.md", "mqtt.md", "operating.md", "cameras.md")

LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")
KEY_CELLS = re.compile(r"^\| (`[^|]+) \|(.*)")
KEY = re.compile(r"`([a-z][a-z_-]+)[ `]")
HEADING = re.compile(r"^#+ (.+)$")
CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from elsewhere, and the description of the page's API."""
    root = Path(config.config_file_path).parent
    for uri, origin in FROM_ELSEWHERE.items():
        files.append(File.generated(config, uri, abs_src_path=str(root / origin)))
    files.append(File.generated(config, "openapi.json", content=json.dumps(openapi_document(), indent=1)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the links of a page, fill in the index, and rank the page in the search."""
    uri = page.file.src_uri
    if uri == INDEX:
        markdown = markdown.replace(INDEX_MARK, index_of_keys(files))
    if uri.startswith(BEHIND_OTHERS) and uri not in FOR_USERS:
        page.meta["search"] = {"boost": 0.1}
    if uri == BEFORE_OTHERS:
        page.meta["search"] = {"boost": 4}
    origin = FROM_ELSEWHERE.get(uri, f"docs/{uri}")
    return LINK.sub(lambda link: in_site(link[1], origin, uri, str(config.repo_url)) + (link[2] or ""), markdown)


def in_site(target: str, origin: str, uri: str, repository: str) -> str:
    """Return where a link leads: within the site, or to the repository for a file that the site has not.

    Args:
        target: The link as it is written, relative to its page in the repository.
        origin: The page's path in the repository.
        uri: The page's path in the site.
        repository: Where the repository is on the network.
    """
    path = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
    sites = {original: page for page, original in FROM_ELSEWHERE.items()}
    if path not in sites and not path.startswith("docs/"):
        return f"{repository}/blob/main/{path}"
    return posixpath.relpath(sites.get(path, path.removeprefix("docs/")), posixpath.dirname(uri) or ".")


def index_of_keys(files: Files) -> str:
    """Return a list of all keys that tables of the reference begin with, each with the sections that have it."""
    places = defaultdict(list)
    for uri in INDEXED:
        if page := files.get_file_from_path(uri):
            for key, place in keys_of(page.content_string, uri):
                if place not in places[key]:
                    places[key].append(place)
    return "\n".join(f"- `{key}`: {', '.join(places[key])}" for key in sorted(places))


def keys_of(markdown: str, uri: str) -> Iterator[tuple[str, str]]:
    """Yield each key that a table names, with a link to its section: of the first column, and of columns of keys."""
    used: set[str] = set()
    place, second = "", False
    for line in CODE.sub("", markdown).splitlines():
        if heading := HEADING.match(line):
            words = re.sub(r"[`\[\]]", "", heading[1])
            place = f"[{words}]({uri}#{unique(slugify(case='lower')(words, '-'), used)})"
        elif cells := KEY_CELLS.match(line):
            for key in KEY.findall(cells[1] + (cells[2] if second else "")):
                yield key, place
        elif line.startswith("| "):
            second = "its keys" in line or (second and line.startswith("| ---"))
