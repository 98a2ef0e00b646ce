"""Pages that are complete in themselves: templates filled, and a policy under which a page connects to nothing."""

import base64
import hashlib
import re
from collections.abc import Mapping


def filled(template: str, parts: Mapping[str, str], *, scripts: str = "") -> str:
    """Fill the marks `@NAME@` of a page, once: what is put in stays as it is; `@POLICY@` last.

    Args:
        template: the page.
        parts: what to put in by name; other marks stay.
        scripts: what else its programs may do, such as `'wasm-unsafe-eval'`.
    """
    marks = re.compile(f"@({'|'.join(parts)})@")
    text = marks.sub(lambda found: parts[found[1]], template)
    return text.replace("@POLICY@", _policy(text, scripts), 1)


def json_in_script(text: str) -> str:
    """Make JSON safe in a script element: "</script" would end it, and "<!--<script" swallow what follows."""
    return text.replace("<", "\\u003c")


def _policy(text: str, scripts: str) -> str:
    """Content-Security-Policy of a page: its own programs and styles run, nothing is fetched or sent."""
    kinds = (("script-src", scripts, r"<script>(.*?)</script>"), ("style-src", "", r"<style>(.*?)</style>"))
    allowed = []
    for kind, more, pattern in kinds:
        digests = [hashlib.sha256(part.encode()).digest() for part in re.findall(pattern, text, re.DOTALL)]
        hashes = [f"'sha256-{base64.b64encode(d).decode()}'" for d in digests]
        allowed.append(" ".join([kind, *([more] if more else []), *hashes]))
    return "; ".join(["default-src 'none'", *allowed, "img-src data:", "base-uri 'none'", "form-action 'none'"])
