"""Hooks of MkDocs: pages made from parsers and declarations, sections of READMEs, equations."""

import re
from html import unescape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

from docs.site import api, effects, verbs
from docs.site.included import ROOT, Missing, picture, pictures, with_included


def on_config(config):
    """Add the pages of the verbs to the navigation."""
    reference = next(part["Reference"] for part in config.nav if "Reference" in part)
    reference.append({"Command line": [verbs.INDEX, *verbs.pages()]})
    return config


def on_files(files, config):
    """Add the pages and pictures that are not files in docs/."""
    for path, text in {**verbs.pages(), verbs.INDEX: verbs.index(), effects.PAGE: effects.page(), api.PAGE: api.page()}.items():
        files.append(File.generated(config, path, content=text))
    for file in dict.fromkeys(pictures()):
        files.append(File.generated(config, picture(file), abs_src_path=str(ROOT / file)))
    files.append(File.generated(config, "site.css", abs_src_path=str(Path(__file__).with_name("site.css"))))
    return files


def on_page_markdown(markdown, page, config, files):
    """Insert sections of READMEs."""
    try:
        return with_included(page.file.src_uri, markdown)
    except Missing as error:
        raise PluginError(f"{page.file.src_uri}: {error}") from error


def on_page_content(html, page, config, files):
    """Convert equations to MathML, which browsers show without a script."""

    def block(found: re.Match) -> str:
        text, name = re.subn(r"\\tag\{(.*?)\}", "", unescape(found[1])), re.search(r"\\tag\{(.*?)\}", found[1])
        number = f'<span class="number">({name[1]})</span>' if name else ""
        return f'<div class="equation">{convert(text[0].strip(), display="block")}{number}</div>'

    html = re.sub(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', block, html, flags=re.S)
    return re.sub(r'<span class="arithmatex">\\\((.*?)\\\)</span>', lambda m: convert(unescape(m[1])), html, flags=re.S)
