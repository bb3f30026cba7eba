"""Make notebooks of tutorials: `python docs/notebooks.py [NAME ...]` writes docs/tutorials/NAME.ipynb.

The tutorial's Markdown is the only source: its blocks of code become cells, in order, and the text between
them cells of text. The notebooks are run and committed with their outputs.
"""

import io
import os
import re
import sys
import tempfile
from base64 import b64decode, b64encode
from collections.abc import Iterator
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook
from PIL import Image

from quadsim.runs.files import write_whole

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "tutorials"
NAMES = ("data", "add", "estimator")
"""Tutorials that have a notebook."""
BLOCK = re.compile(
    r"```(?P<language>sh|python|toml)(?: title=\"(?P<file>[^\"]+)\")?\n(?P<code>.*?)```\n"
    r"(?:<!-- shows: (?P<picture>\S+) -->\n)?",
    re.DOTALL,
)
LINK = re.compile(r"\[([^\]]*)\]\((?!https?:)[^)]*\)")
"""A link to another page of the site, which a notebook does not have beside it."""
COLOURS, WIDTH = 48, 800
"""Colours and largest width [px] of a picture in a notebook."""
INSTALL = (
    "*A notebook of quadsim's tutorial. It needs quadsim in the environment of its kernel, and writes files "
    "beside itself.*"
)


def notebook(name: str) -> NotebookNode:
    """The notebook of a tutorial's Markdown as it is now, without outputs."""
    cells = list(cells_of((FOLDER / f"{name}.md").read_text("utf-8")))
    head, _, rest = cells[0].source.partition("\n")
    cells[0].source = f"{head}\n\n{INSTALL}\n{rest}".rstrip()
    for k, cell in enumerate(cells):
        cell.id = f"{name}-{k}"
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return new_notebook(cells=cells, metadata={"kernelspec": kernel, "language_info": {"name": "python"}})


def cells_of(text: str) -> Iterator[NotebookNode]:
    """Cells of a tutorial: text, and code that does what the block says."""
    before, *rest = BLOCK.split(text)
    yield new_markdown_cell(LINK.sub(r"\1", before.strip()))
    for language, file, code, picture, after in zip(*[iter(rest)] * 5, strict=True):
        magic = f"%%writefile {file}\n" if file else "%%bash -e\n" * (language == "sh")
        yield new_code_cell(f"{magic}{code}".rstrip("\n"), metadata={"language": language})
        if picture:
            shown = f'from IPython.display import Image\n\nImage("{picture}")'
            yield new_code_cell(shown, metadata={"language": "picture"})
        if after.strip():
            yield new_markdown_cell(LINK.sub(r"\1", after.strip()))


def executed(book: NotebookNode) -> NotebookNode:
    """The notebook with the outputs of a run in an empty folder, without bars of progress.

    Raises:
        nbclient.exceptions.CellExecutionError: A cell failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        scripts = Path(sys.executable).parent
        env = os.environ | {"PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
        env |= {"COLUMNS": "100", "TTY_COMPATIBLE": "0"}  # no colours of a terminal
        client = NotebookClient(
            book, timeout=300, kernel_name="python3", record_timing=False, coalesce_streams=True,
            resources={"metadata": {"path": folder}},
        )  # fmt: skip
        client.execute(env=env)
        for cell in book.cells:
            if cell.cell_type == "code":
                cell.outputs = [tidy(each, folder) for each in cell.outputs if each.get("name") != "stderr"]
    return book


def tidy(output: NotebookNode, folder: str) -> NotebookNode:
    """An output with relative paths and small pictures."""
    if "text" in output:
        text = output.text.replace(f"{Path(folder).resolve()}/", "").replace(f"{folder}/", "")
        output.text = re.sub(r" +$", "", text, flags=re.MULTILINE)
    if "image/png" in output.get("data", {}):
        output.data = NotebookNode({"image/png": smaller(output.data["image/png"])})
        output.metadata = NotebookNode()
    return output


def smaller(picture: str) -> str:
    """A PNG in base64 with few colours, not wider than a page."""
    image = Image.open(io.BytesIO(b64decode(picture))).convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    file = io.BytesIO()
    image.convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS).save(file, "PNG", optimize=True)
    return b64encode(file.getvalue()).decode()


def main() -> None:
    """Make the named notebooks, or all."""
    for name in sys.argv[1:] or NAMES:
        path = FOLDER / f"{name}.ipynb"
        write_whole(path, nbformat.writes(executed(notebook(name))) + "\n")
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main()
