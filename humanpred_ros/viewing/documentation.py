"""The documentation as a site in a browser: `humanpred docs`."""

from __future__ import annotations

import os
import tempfile
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from rich.console import Console

from humanpred_ros.errors import UsageError
from humanpred_ros.resources import share_file
from humanpred_ros.settings import Settings, setting
from humanpred_ros.viewing.space import free_port


class DocsSettings(Settings):
    """Settings of `humanpred docs`."""

    out: Path | None = setting(None, "folder to write the site to, instead of showing it")
    port: int = setting(8000, "first port that is tried", low=1, high=65535)


def docs(settings: DocsSettings, console: Console) -> int:
    """Show the documentation in a browser, without a network, until Ctrl-C, or write it as a folder of pages."""
    try:
        from mkdocs.commands.build import build
        from mkdocs.config import load_config
    except ImportError as missing:
        raise UsageError(f"docs: wanted mkdocs, got none ({missing}); install the `docs` extra") from missing
    os.environ["NO_MKDOCS_2_WARNING"] = "1"
    with tempfile.TemporaryDirectory() as made:
        folder = settings.out or Path(made)
        with console.status("writing the pages"):
            build(load_config(str(share_file("mkdocs.yml")), site_dir=str(folder.resolve())))
        if settings.out is not None:
            console.print(f"site  {settings.out / 'index.html'}")
            return 0
        port = free_port("127.0.0.1", settings.port)
        served = partial(SimpleHTTPRequestHandler, directory=made)
        console.print(f"open http://127.0.0.1:{port}/index.html in a browser; Ctrl-C ends it", highlight=False)
        with ThreadingHTTPServer(("127.0.0.1", port), served) as server:
            server.serve_forever()
    return 0
