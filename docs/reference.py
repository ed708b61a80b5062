"""Files generated from the program's definitions: the recipe, the man page, completion for three shells.

`make reference` writes them, and a test compares them with the code. The site adds the command line to its page.
"""

import argparse
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "spheremouse"
WIDTH = 100  # columns of `--help`
COMPLETIONS = {
    "bash": "bash-completion/completions/spheremouse",
    "zsh": "zsh/site-functions/_spheremouse",
    "fish": "fish/vendor_completions.d/spheremouse.fish",
}
# The program's shell is not in the module reference, which is for those who call the core.
_OUTER = {"__main__", "commands", "session", "capture", "files"}
_MADE = "<!-- Made by `make reference`. -->\n"


def made() -> dict[Path, str]:
    """Every file that is made here, with its text."""
    share = ROOT / "service" / "share"
    return {
        ROOT / "docs" / "calibration-recipe.md": recipe_page(),
        share / "man" / "man1" / "spheremouse.1": man_page(),
        **{share / path: completion(shell) for shell, path in COMPLETIONS.items()},
    }


# ---- the command line ----


def _commands() -> Iterator[tuple[Any, Any]]:
    """Every command that is shown, with its context: a group before those that are in it."""
    import typer.main

    from spheremouse.commands import app

    def below(command: Any, name: str, parent: Any) -> Iterator[tuple[Any, Any]]:
        context = command.context_class(command, info_name=name, parent=parent, terminal_width=WIDTH, **_SETTINGS)
        yield command, context
        for sub, one in getattr(command, "commands", {}).items():
            if not one.hidden:
                yield from below(one, sub, context)

    return below(typer.main.get_command(app), "spheremouse", None)


_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": WIDTH}


def command_line() -> str:
    """Return a table of the commands and `--help` of each, in Markdown."""
    rows, parts = [], []
    for command, context in _commands():
        words = context.command_path
        text = "\n".join(line.rstrip() for line in command.get_help(context).strip("\n").splitlines())
        parts.append(f"## {words}\n\n```text\n{text}\n```\n")
        if context.parent is not None and context.parent.parent is None:
            rows.append(f"| [`{words}`](#{words.replace(' ', '-')}) | {_first_sentence(command.help)} |")
    return "\n".join(["", "| command | |", "| --- | --- |", *rows, "", *parts])


def man_page() -> str:
    """spheremouse(1), in the macros of man(7); all commands on one page, to be searched."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    out = [
        f'.TH SPHEREMOUSE 1 "" "spheremouse {project["version"]}" "User Commands"',
        f".SH NAME\nspheremouse \\- {_roff(project['description'])}",
    ]
    for command, context in _commands():
        usage = " ".join(command.collect_usage_pieces(context))
        synopsis = f".B {_roff(context.command_path)}\n{_roff(usage)}"
        if context.parent is None:
            out += [f".SH SYNOPSIS\n{synopsis}", f".SH DESCRIPTION\n{_paragraphs(command)}"]
            out += [f".SH OPTIONS\n{_options(command, context)}", ".SH COMMANDS"]
        else:
            out += [f".SS {_roff(context.command_path)}\n{synopsis}\n.PP\n{_paragraphs(command)}"]
            out += [_options(command, context)]
    out += [_END]
    return "\n".join(text for text in out if text) + "\n"


_END = r"""
.SH EXIT STATUS
0: done. 2: an error that you can correct. 70: a fault of the program. 128 plus a signal's number: ended by that signal.
Commands that go on until a signal end with 0.
.BR doctor ", " "firmware check" " and " "service status"
end with 1 if they find a fault.
.B spheremouse ctl
ends with 1 if the daemon refuses, and 3 without a daemon.
.SH ENVIRONMENT
.TP
.B SPHEREMOUSE_SOCKET
The daemon's socket.
.SH FILES
.TP
.I /etc/spheremouse/config.yaml, /etc/spheremouse/rig.yaml
Configuration and calibrated device of the service.
.TP
.I /var/lib/spheremouse
The service's map of discs, recordings and snapshots.
""".strip()


def _paragraphs(command: Any) -> str:
    texts = [*re.split(r"\n\s*\n", (command.help or "").strip()), command.epilog or ""]
    return "\n.PP\n".join(_roff(" ".join(text.split())) for text in texts if text.strip())


def _options(command: Any, context: Any) -> str:
    records = filter(None, (one.get_help_record(context) for one in command.get_params(context)))
    return "\n".join(f".TP\n.B {_roff(name)}\n{_roff(' '.join(text.split()))}" for name, text in records)


def _roff(text: str) -> str:
    """Text as it stands: no mark of roff's is one here."""
    text = (
        text.replace("\\", "\\e").replace("-", "\\-").replace("`", "\\(ga").replace("^", "\\(ha").replace("~", "\\(ti")
    )
    text = re.sub(r"[^\x00-\x7f]", lambda m: f"\\[u{ord(m[0]):04X}]", text)
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.MULTILINE)


def completion(shell: str) -> str:
    """Return the completion script of a shell. It gets the words from the program itself."""
    from typer.testing import CliRunner

    from spheremouse.commands import app

    made = CliRunner(env={"_SPHEREMOUSE_COMPLETE": f"source_{shell}"}).invoke(app, prog_name="spheremouse")
    # The first Tab loads the file, and is to be answered, too.
    first = '\n[[ $zsh_eval_context[-1] != loadautofunc ]] || _spheremouse_completion "$@"' if shell == "zsh" else ""
    return f"{made.stdout.strip()}{first}\n"


# ---- modules ----


def core() -> list[str]:
    """Names of the core's rooms, from the ground up, as import-linter holds them."""
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    layers = next(c["layers"] for c in tools["importlinter"]["contracts"] if c["id"] == "layers")
    return [room for layer in reversed(layers) for room in re.findall(r"\w+", layer) if room not in _OUTER]


def core_modules() -> dict[str, Path]:
    """Files of the core's modules by their names, in the rooms' order."""
    found = {}
    for room in core():
        for path in sorted([*PACKAGE.glob(f"{room}.py"), *(PACKAGE / room).rglob("*.py")]):
            name = path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
            if path.stat().st_size > 0:
                found[name] = path
    return found


def _first_sentence(text: str | None) -> str:
    """For a cell of a table."""
    first = re.split(r"\n\s*\n", (text or "").strip())[0]
    return re.split(r"(?<=[.:;]) (?=[A-Z`])", " ".join(first.split()))[0].rstrip(".:").replace("|", "\\|")


# ---- the recipe ----


def recipe_page() -> str:
    """The recipe that `calibrate print` prints, to be read here; its drawings are on the print."""
    text = (PACKAGE / "calibrate" / "prints" / "recipe.md").read_text(encoding="utf-8")
    title, _, rest = text.partition("\n")
    return f"{title}\n\n{_MADE}\n`spheremouse calibrate print` makes this page with drawings.\n{rest}"


def main() -> None:
    """Write what differs."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for path, text in made().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            print(path.relative_to(ROOT), file=sys.stderr)


if __name__ == "__main__":
    main()
