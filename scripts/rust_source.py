"""Reads Rust source well enough to count things in it; used by check-words and house-marks."""

import pathlib
import re
import subprocess

COMMENT = re.compile(r"^\s*//")
DOC = re.compile(r"^\s*//[/!](?!/)")


def tracked(root, *patterns):
    """Returns the files that git tracks, by pattern."""
    command = ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *patterns]
    names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\0")
    return sorted({root / name for name in names if name and (root / name).is_file()})


def is_production(path):
    """Returns whether a file is neither a test nor a bench, an example or a fuzzing target."""
    return path.name not in ("tests.rs", "build.rs") and not {"tests", "benches", "examples", "fuzz"} & set(path.parts)


TOKEN = re.compile(
    r"//[^\n]*|/\*.*?\*/"
    r"|b?r(#*)\".*?\"\1|b?\"(?:\\.|[^\"\\])*\""
    r"|b?'(?:\\(?:u\{[^}]*\}|x..|.)|[^'\\\n])'",
    re.DOTALL,
)


def code(text):
    """Returns source with comments, strings and characters blanked; positions stay the same."""
    return TOKEN.sub(lambda match: re.sub(r"[^\n]", " ", match.group(0)), text)


def closing(text, start, pair="{}"):
    """Returns the position of the bracket that closes the one at `start`."""
    depth = 0
    for match in re.compile(f"[{re.escape(pair)}]").finditer(text, start):
        depth += 1 if match.group(0) == pair[0] else -1
        if depth == 0:
            return match.start()
    return len(text) - 1


def without_tests(blank):
    """Returns code with its `#[cfg(test)]` modules blanked."""
    for match in re.finditer(r"#\[cfg\(test\)\]\s*(?:#\[[^\]]*\]\s*)*mod\s+\w+\s*\{", blank):
        end = closing(blank, match.end() - 1) + 1
        blank = blank[: match.start()] + re.sub(r"[^\n]", " ", blank[match.start() : end]) + blank[end:]
    return blank


def production_lines(text):
    """Returns the number of lines of a file outside of its test modules."""
    for match in re.finditer(r"#\[cfg\(test\)\]\s*(?:#\[[^\]]*\]\s*)*mod\s+\w+\s*\{", code(text)):
        end = closing(code(text), match.end() - 1)
        return production_lines(text[: match.start()] + text[end + 1 :])
    return text.count("\n")


class Function:
    """One `fn`: name, line, number of lines, types of its parameters."""

    def __init__(self, name, line, lines, parameters):
        self.name, self.line, self.lines, self.parameters = name, line, lines, parameters


def functions(blank):
    """Yields the functions with a body in blanked code."""
    for match in re.finditer(r"\bfn\s+(\w+)", blank):
        opening = parameters_start(blank, match.end())
        if opening is None:
            continue
        close = closing(blank, opening, "()")
        line = blank.count("\n", 0, match.start()) + 1
        body = body_start(blank, close + 1)
        lines = blank.count("\n", match.start(), closing(blank, body)) + 1 if body is not None else 0
        yield Function(match.group(1), line, lines, split(blank[opening + 1 : close]))


def parameters_start(blank, position):
    """Returns the position of the parenthesis that opens the parameters, past any generics."""
    position = re.compile(r"\s*").match(blank, position).end()
    if blank[position : position + 1] == "<":
        depth = 0
        for match in re.compile(r"->|[<>]").finditer(blank, position):
            depth += {"<": 1, ">": -1}.get(match.group(0), 0)
            if depth == 0:
                position = re.compile(r"\s*").match(blank, match.end()).end()
                break
    return position if blank[position : position + 1] == "(" else None


def body_start(blank, position):
    """Returns the position of the brace that opens a body, or None for a declaration."""
    depth = 0
    for match in re.compile(r"[\[\](){;]").finditer(blank, position):
        token = match.group(0)
        if depth == 0 and token in "{;":
            return match.start() if token == "{" else None
        depth += {"[": 1, "(": 1, "]": -1, ")": -1}.get(token, 0)
    return None


def split(text):
    """Returns the parts of a list separated by commas outside of any brackets."""
    parts, depth, start = [], 0, 0
    for match in re.finditer(r"->|[,<>()\[\]{}]", text):
        token = match.group(0)
        if token == "," and depth == 0:
            parts.append(text[start : match.start()])
            start = match.end()
        elif token in "<([{":
            depth += 1
        elif token in ">)]}":
            depth -= 1
    return [part.strip() for part in [*parts, text[start:]] if part.strip()]


def has_tuple(parameter):
    """Returns whether the type of a parameter has an anonymous tuple; types of closures do not count."""
    pattern = closing(parameter, 0, "()") if parameter.startswith("(") else 0
    kind = parameter[pattern:].partition(":")[2]
    kind = re.sub(r"\b(?:Fn|FnMut|FnOnce|fn)\s*\([^()]*(?:\([^()]*\)[^()]*)*\)(?:\s*->\s*[^,>]+)?", "", kind)
    return any("," in group for group in re.findall(r"\(([^()]+)\)", kind))


def doc_starts(text):
    """Yields line number and first line of each documentation comment."""
    previous = False
    for number, line in enumerate(text.split("\n"), 1):
        is_doc = bool(DOC.match(line))
        if is_doc and not previous:
            yield number, re.sub(r"^\s*//[/!]\s?", "", line)
        previous = is_doc


def doc_tests(text):
    """Returns the number of code blocks in documentation that are compiled."""
    count, inside = 0, False
    for line in text.split("\n"):
        if DOC.match(line) and (fence := re.match(r"\s*//[/!]\s*```(.*)$", line)):
            if not inside and not re.search(r"\b(text|ignore|sh|toml|json|console|wgsl)\b", fence.group(1)):
                count += 1
            inside = not inside
    return count


def imports(root_file):
    """Returns the graph of imports between the files of a crate: file to files it uses."""
    source = root_file.parent
    modules = {}
    for path in source.rglob("*.rs"):
        parts = list(path.relative_to(source).with_suffix("").parts)
        if parts[-1] in ("mod", "lib", "main"):
            parts.pop()
        if path.name != "tests.rs" and "tests" not in parts:
            modules[tuple(parts)] = path
    graph = {}
    for module, path in modules.items():
        blank = without_tests(code(path.read_text(encoding="utf-8")))
        targets = set()
        for match in re.finditer(r"\b(crate|super|self)((?:::\w+)*)(::\{)?", blank):
            base = {"crate": (), "super": module[:-1], "self": module}[match.group(1)]
            names = re.findall(r"\w+", match.group(2))
            while names and names[0] == "super":
                base, names = base[:-1], names[1:]
            inner = split(blank[match.end() : closing(blank, match.end() - 1)]) if match.group(3) else []
            for branch in [re.findall(r"\w+", part.partition("{")[0]) for part in inner] or [[]]:
                found = resolve(modules, base, names + branch)
                # A module's file declares its children and hands on what they have: that is no import.
                if found is not None and found[: len(module)] != module:
                    targets.add(found)
        graph[module] = targets
    return graph


def resolve(modules, base, names):
    """Returns the deepest module on a path, or None where the path ends in a re-export of the root."""
    module = base
    for name in names:
        if module + (name,) not in modules:
            break
        module = module + (name,)
    return module if module in modules and module != () else None


def cycles(graph):
    """Returns the groups of more than one file that import each other (Tarjan's components)."""
    index, low, stack, found = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in graph.get(node, ()):
            if target not in index:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted("/".join(module) or "root" for module in group))

    for node in graph:
        if node not in index:
            visit(node)
    return found


def crate_of(path, root):
    """Returns the name under which counts of a file are reported."""
    parts = path.relative_to(root).parts
    return parts[1] if parts[0] == "crates" else parts[0]


ROOT = pathlib.Path(__file__).resolve().parent.parent
