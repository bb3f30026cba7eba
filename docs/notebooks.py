"""Make notebooks of tutorials: `python docs/notebooks.py [NAME ...]` writes docs/tutorials/NAME.ipynb.

The tutorial's Markdown is the only source: its blocks of code become cells, in order, and the text between
them cells of text. The notebooks are run and committed with their outputs. `docs/site.py` shows these
outputs below the blocks of the tutorial's page.
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
    head, cells[0].source = cells[0].source.partition("\n")[::2]
    cells[0].source = f"{head}\n\n{INSTALL}\n{cells[0].source}".rstrip()
    for k, cell in enumerate(cells):
        cell.id = f"{name}-{k}"
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return new_notebook(cells=cells, metadata={"kernelspec": kernel, "language_info": {"name": "python"}})


def cells_of(text: str) -> Iterator[NotebookNode]:
    """Cells of a tutorial: text, and code that does what the block says."""
    place = 0
    for block in BLOCK.finditer(text):
        yield from words(text[place : block.start()])
        yield new_code_cell(code_of(block), metadata={"language": block["language"]})
        if block["picture"]:
            shown = f'from IPython.display import Image\n\nImage("{block["picture"]}")'
            yield new_code_cell(shown, metadata={"language": "picture"})
        place = block.end()
    yield from words(text[place:])


def words(text: str) -> Iterator[NotebookNode]:
    """A cell of text, if there is any."""
    if text.strip():
        yield new_markdown_cell(LINK.sub(r"\1", text.strip()))


def code_of(block: re.Match[str]) -> str:
    """The source of a code cell."""
    code = block["code"].rstrip("\n")
    if block["file"]:
        return f"%%writefile {block['file']}\n{code}"
    return f"%%bash -e\n{code}" if block["language"] == "sh" else code


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


def read(name: str) -> NotebookNode:
    """The committed notebook of a tutorial."""
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def with_outputs(name: str, markdown: str) -> str:
    """A tutorial's Markdown with a link to the notebook, and each block's outputs below it."""
    outputs = iter([cell.outputs for cell in read(name).cells if cell.cell_type == "code"])

    def shown(block: re.Match[str]) -> str:
        found = next(outputs) + (next(outputs) if block["picture"] else [])
        text = "" if block["file"] else "".join(each.get("text", "") for each in found).rstrip()
        parts = [block[0], f"```{{ .text .output .no-copy }}\n{text}\n```\n" if text else ""]
        images = [each.data["image/png"] for each in found if "image/png" in each.get("data", {})]
        parts += [f"![What it draws](data:image/png;base64,{image})\n" for image in images]
        return "\n".join(filter(None, parts))

    head, _, rest = BLOCK.sub(shown, markdown).partition("\n")
    link = f'[As a notebook, with outputs]({name}.ipynb){{ download="{name}.ipynb" }}'
    return f"{head}\n\n{link}\n{rest}"


def main() -> None:
    """Make the named notebooks, or all."""
    for name in sys.argv[1:] or NAMES:
        path = FOLDER / f"{name}.ipynb"
        write_whole(path, nbformat.writes(executed(notebook(name))) + "\n")
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main()
