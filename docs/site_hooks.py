"""What the site adds to the pages of this folder: pages from elsewhere, links to the repository, ranks in the search.

Links are written for the repository, where most people meet these pages. The site has only some of its files.
"""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from openapi import openapi_document

FROM_ELSEWHERE = {"contributing.md": "CONTRIBUTING.md", "deploy.md": "deploy/README.md"}
"""Pages of the site that are not in this folder, by their path in the repository."""

BOOSTS = {"troubleshooting.md": 3.0, "contributing.md": 0.1, "reference/": 0.3}
"""How the search ranks pages: the remedy of a symptom first, and behind others what answers no question of users."""

LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from elsewhere, and the description of the page's API."""
    root = Path(config.config_file_path).parent
    for uri, origin in FROM_ELSEWHERE.items():
        files.append(File.generated(config, uri, abs_src_path=str(root / origin)))
    files.append(File.generated(config, "openapi.json", content=json.dumps(openapi_document(), indent=1)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001 - as it is called
    """Turn the links of a page, and rank it in the search."""
    uri = page.file.src_uri
    if boost := next((boost for start, boost in BOOSTS.items() if uri.startswith(start)), None):
        page.meta["search"] = {"boost": boost}
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
