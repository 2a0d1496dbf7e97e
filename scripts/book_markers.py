"""What stands between the markers of the book's pages, made from data and source files.

`scripts/book-tables` describes the markers. Each function here takes the page and what stands in the
marker, and returns the Markdown to put there.
"""

import csv
import datetime
import pathlib
import re
import sys
import textwrap

ROOT = pathlib.Path(__file__).resolve().parent.parent
SOURCE = ROOT / "docs" / "src"
NUMBER = re.compile(r"^[-+]?[\d.,]+(e[-+]?\d+)?( %| dB| ms| s| MB| MiB| GB| GiB)?( \([-+\d., to]+\)| ± [\d.]+)?$")


def shown(cell):
    """Returns a cell as the page shows it: large whole numbers with separators, bars escaped."""
    if re.fullmatch(r"\d{5,}", cell):
        return f"{int(cell):,}"
    return cell.replace("|", "\\|")


def markdown(header, rows):
    """Returns a Markdown table; columns of numbers are aligned to the right."""
    numeric = [all(NUMBER.match(row[i]) or not row[i] for row in rows) for i in range(len(header))]
    lines = ["| " + " | ".join(header) + " |", "|" + "|".join("--:" if n else "---" for n in numeric) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(re.sub(r" +\|", " |", line) for line in lines)


def rows_of(path):
    """Returns header and rows of a CSV file."""
    with open(path, newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file))
    if len(set(header)) != len(header):
        sys.exit(f"{path}: two columns have one name: {header}")
    for row in rows:
        if len(row) != len(header):
            sys.exit(f"{path}: a row has {len(row)} cells, the header {len(header)}: {row}")
    return header, rows


def table(page, what):
    """Returns the table, or the list, of a CSV file."""
    path, *options = [part.strip() for part in what.split("|")]
    header, rows = rows_of(page.parent / path)
    hidden, columns, item = set(), None, None
    for option in options:
        word, _, value = option.partition(" ")
        if word == "where":
            column, _, wanted = value.partition("=")
            rows = [row for row in rows if row[header.index(column)] == wanted]
            hidden.add(column)
        elif word == "columns":
            columns = [name.strip() for name in value.split(";")]
        elif word == "list":
            item = value.strip()
        else:
            sys.exit(f"{page}: unknown option of a table: {option}")
    if item:
        # Links of the file are relative to it.
        base = pathlib.PurePosixPath(path).parent
        lines = [relinked(row[header.index(item)], base) for row in rows]
        return "\n" + "\n".join(textwrap.fill(f"- {line}", 100, subsequent_indent="  ", break_on_hyphens=False) for line in lines) + "\n\n"
    if "adopted" in header:
        index = header.index("adopted")
        hidden.add("adopted")
        rows = [[f"**{row[0]}**" if row[index] == "yes" else row[0]] + row[1:] for row in rows]
    columns = columns or [name for name in header if name not in hidden]
    order = [header.index(name) for name in columns]
    body = markdown(columns, [[shown(row[i]) for i in order] for row in rows])
    return f"\n{body}\n\n[Data]({path})\n\n"


def relinked(text, base):
    """Returns a text whose relative links lead from a page above `base`."""
    join = lambda match: f"]({posix_join(base, match.group(1))})"
    return re.sub(r"\]\((?!https?:)([^)]+)\)", join, text)


def posix_join(base, link):
    """Returns a link of a file in `base`, without `..`."""
    parts = []
    for part in [*base.parts, *pathlib.PurePosixPath(link).parts]:
        parts = parts[:-1] if part == ".." and parts else [*parts, part]
    return "/".join(parts)


def value(page, what):
    """Returns one cell of a CSV file: the column, of the only row with these values."""
    path, column, *wanted = [part.strip() for part in what.split("|")]
    header, rows = rows_of(page.parent / path)
    for condition in wanted:
        name, _, text = condition.partition("=")
        rows = [row for row in rows if row[header.index(name)] == text]
    if len(rows) != 1:
        sys.exit(f"{page}: {len(rows)} rows of {path} have {', '.join(wanted)}, expected one")
    return shown(rows[0][header.index(column)])


def field(text, name):
    """Returns the value of an item `- **Name:** value` at the head of a page, on one line."""
    found = re.search(rf"^- \*\*{name}:\*\* (.*?)(?=\n- \*\*|\n\n)", text, re.DOTALL | re.MULTILINE)
    return re.sub(r"\s+", " ", found.group(1)).strip() if found else ""


NOTEBOOK = SOURCE / "notebook"
SUMMARY = (NOTEBOOK / "SUMMARY.md").read_text(encoding="utf-8")


def notebook_pages():
    """Yields topic, path and text of each page of the notebook."""
    topic = None
    for heading, link in re.findall(r"^# (.+)$|^- \[[^\]]+\]\(([^)]+\.md)\)$", SUMMARY, re.MULTILINE):
        topic = heading or topic
        if link:
            text = (NOTEBOOK / link).read_text(encoding="utf-8")
            if not field(text, "Status"):
                sys.exit(f"{NOTEBOOK / link}: no status at its head")
            yield topic, NOTEBOOK / link, text


def index(page, what):
    """Returns the notebook's pages by topic; with "adopted" those that set a default, without the date."""
    names = ["Decision", "Sets"] if what == "adopted" else ["Decision", "Sets", "Status", "Date"]
    headings = {"Decision": "decision", "Sets": "default it set", "Status": "status", "Date": "date"}
    tables = {}
    for topic, path, text in notebook_pages():
        if what == "adopted" and not field(text, "Status").startswith("adopted"):
            continue
        link = path.relative_to(page.parent).as_posix()
        base = path.parent.relative_to(page.parent).as_posix()
        cells = [relinked(field(text, name), pathlib.PurePosixPath(base)) for name in names]
        title = text.split("\n", 1)[0].lstrip("# ")
        tables.setdefault(topic, []).append([f"[{title}]({link})", *cells])
    parts = [f"## {topic}\n\n" + markdown(["question", *(headings[name] for name in names)], rows) for topic, rows in tables.items()]
    return "\n" + "\n\n".join(parts) + "\n\n"


def age(page, _what):
    """Returns a notice if the parts that the page measures have changed since its date."""
    text = page.read_text(encoding="utf-8")
    parts = [part.strip() for part in field(text, "Measures").split(",")]
    dates = re.findall(r"\d{4}-\d{2}-\d{2}", field(text, "Date"))
    if not dates:
        sys.exit(f"{page}: a page that says what it measures needs a date")
    header, rows = rows_of(NOTEBOOK / "data" / "changes.csv")
    rows = [dict(zip(header, row)) for row in rows]
    if unknown := set(parts) - {row["part"] for row in rows}:
        sys.exit(f"{page}: measures {', '.join(unknown)}, of which changes.csv knows nothing")
    # A change of the last day of measuring may be in the program that was measured.
    later = [row for row in rows if row["part"] in parts and row["date"] > max(dates)]
    if not later:
        return "\n"
    month = lambda date: datetime.date.fromisoformat(date).strftime("%Y-%m-%d")
    changes = "; ".join(f"{row['change']} ({month(row['date'])})" for row in later)
    return "\n" + textwrap.fill(f"> **Measured on an earlier program.** Since then: {changes}.", 100, subsequent_indent="> ") + "\n\n"


def features(page, what):
    """Returns the features of a manifest, with the comment above each."""
    text = (page.parent / what.strip()).read_text(encoding="utf-8")
    section = re.search(r"^\[features\]\n(.*?)^\[", text, re.DOTALL | re.MULTILINE).group(1)
    default = set(re.findall(r'"([^"]+)"', re.search(r"^default = \[(.*?)\]", section, re.MULTILINE).group(1)))
    rows = []
    for comment, name in re.findall(r"^((?:# .*\n)+)([a-z-]+) = ", section, re.MULTILINE):
        sentence = " ".join(line[2:] for line in comment.strip().split("\n")).rstrip(".")
        rows.append([f"`{name}`" + (" (default)" if name in default else ""), sentence[0].lower() + sentence[1:] if sentence.split()[0].istitle() else sentence])
    undocumented = set(re.findall(r"^([a-z-]+) = ", section, re.MULTILINE)) - {"default"} - {row[0].split("`")[1] for row in rows}
    if undocumented:
        sys.exit(f"{what}: features without a comment: {', '.join(sorted(undocumented))}")
    rows.sort(key=lambda row: "(default)" not in row[0])
    return "\n" + markdown(["feature", "what it adds"], rows) + "\n\n"


def uncovered(page, what, table_text):
    """Yields an error for each variant of a Rust enum without a row in a table, and each row without one.

    A row is a variant's if its first cell has, as code, the variant's name or code of its comment. Rows
    named behind `| and` may be there, too.
    """
    path, name, *more = [part.strip() for part in what.split("|")]
    rows = [set(re.findall(r"`([^`]+)`", line.split("|")[1])) for line in table_text.split("\n")[2:] if line.startswith("|")]
    place = page.relative_to(ROOT)
    names = [set(re.findall(r"`([^`]+)`", " ".join(more)))]
    for value, meaning in variants(page, path, name):
        names.append({value, *re.findall(r"`([^`]+)`", meaning)})
        if not any(row & names[-1] for row in rows):
            yield f"{place}: the table has no row for {name}'s `{value}` ({path})"
    for row in rows:
        if not any(row & known for known in names):
            yield f"{place}: {name} ({path}) has nothing for the row {', '.join(sorted(row))}"


def variants(page, path, name):
    """Returns name and comment of each variant of a Rust enum."""
    text = (page.parent / path).read_text(encoding="utf-8")
    body = re.search(rf"\benum {name} \{{\n(.*?)^\}}", text, re.DOTALL | re.MULTILINE)
    if not body:
        sys.exit(f"{page}: no enum {name} in {path}")
    rows, doc, renamed = [], [], None
    for line in (line.strip() for line in body.group(1).split("\n")):
        if line.startswith("///"):
            doc.append(line[3:].strip())
        elif rename := re.search(r'rename = "([^"]+)"', line):
            renamed = rename.group(1)
        elif variant := re.fullmatch(r"([A-Z]\w*),?", line):
            if not doc:
                sys.exit(f"{path}: {name}::{variant.group(1)} has no doc comment")
            rows.append((renamed or kebab(variant.group(1)), " ".join(doc).rstrip(".")))
            doc, renamed = [], None
    return rows


def kebab(name):
    """Returns `HdrNerf` as `hdr-nerf`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()


def presets(page, _what):
    """Returns the table of presets, with the experiments that set each option."""
    config = ROOT / "crates" / "train" / "src" / "config"
    options = (config / "options.rs").read_text(encoding="utf-8")
    text = re.search(r"^presets! \{\n(.*?)^\}", (config / "preset.rs").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE).group(1)
    pages = [(path, text_of, field(text_of, "Sets")) for _, path, text_of in notebook_pages()]
    rows = []
    for name, values in re.findall(r"^    (\w+): +(.*);$", text, re.MULTILINE):
        flag = "--" + name.replace("_", "-")
        paper, full, fast = [preset_value(cell.strip(), name, options) for cell in values.split(",")]
        links = [f"[{title(text_of)}](../notebook/{path.name})" for path, text_of, sets in pages if re.search(rf"`{flag}[ `]", sets)]
        full, paper = ["as `fast`" if cell == fast and len(cell) > 20 else cell for cell in (full, paper)]
        rows.append([f"`{name}`", fast, full, paper, ", ".join(links)])
    return "\n" + markdown(["option", "`fast` (default)", "`full`", "`paper`", "experiments"], rows) + "\n\n"


def title(text):
    """Returns the title of a page of the notebook in the table of contents."""
    heading = text.split("\n", 1)[0]
    for name, link in re.findall(r"\[([^\]]+)\]\(([^)]+)\)", SUMMARY):
        if (NOTEBOOK / link).read_text(encoding="utf-8").startswith(heading + "\n"):
            return name[0].lower() + name[1:] if name[1:2].islower() else name
    sys.exit(f"{heading}: not in the notebook's SUMMARY.md")


def preset_value(cell, name, options):
    """Returns a value of Rust as a configuration file has it."""
    if cell == "None":
        note = re.search(rf'\b{name}: [^\n]*unset: "([^"]*)"', options)
        return note.group(1).replace("`", "") if note else "not set"
    cell = re.sub(r"^Some\((.*)\)$", r"\1", cell)
    if variant := re.fullmatch(r"\w+::(\w+)", cell):
        return kebab(variant.group(1))
    cell = cell.replace("_", "")
    return "0" if re.fullmatch(r"0(\.0*)?", cell) else cell
