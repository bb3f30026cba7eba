"""What axe-core finds wrong with a page for people who see or point otherwise."""

import pytest


def findings(page):
    """Serious and critical findings, each with the first elements it is about."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(page).response["violations"]
    return [
        f"{each['id']}: {[node['target'] for node in each['nodes']][:3]}"
        for each in found
        if each["impact"] in ("serious", "critical")
    ]
