"""Commands that show drives and labels."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from upvl_cli.cli.application import OneFrame, OneSegment, app
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace


@app.command()
def draw(
    context: typer.Context,
    segment: OneSegment = None,
    frame: OneFrame = None,
    words: Annotated[
        str | None, typer.Option(help='Colour each point by its nearest word: "car, tree, person".')
    ] = None,
    semantics: Annotated[
        bool,
        typer.Option(
            "--semantics",
            help="Colour each point by its class, fused over the drive: run upvl semantics first.",
        ),
    ] = False,
    animate: Annotated[
        bool,
        typer.Option(
            "--animate",
            help="Draw the drive over time into one animated picture, from above and by the camera that looks ahead: "
            "out/draw/DRIVE.webp, or .gif.",
        ),
    ] = False,
    animate_as: Annotated[
        str,
        typer.Option(
            help="Format of --animate. webp: all colours, shown by browsers and GitHub; gif: fewer colours and four "
            "times the bytes, shown by every program.",
            metavar="webp|gif",
        ),
    ] = "webp",
) -> None:
    """Draw points, boxes and tracks from above, and boxes on the camera's picture."""
    from upvl_cli.commands.draw import draw_frame
    from upvl_cli.commands.draw_words import draw_semantics, draw_words, split_words

    if semantics and words is not None:
        raise BadSetting("both --words and --semantics are given; points have one colour each: leave one out")
    if animate and (semantics or words is not None or frame is not None):
        raise BadSetting("--animate draws boxes over all frames; leave out --frame, --words and --semantics")
    workspace: Workspace = context.obj
    for name in workspace.segments if segment is None else [segment]:
        workspace.check_name(name, workspace.segments)
        if animate:
            _animate(workspace, name, animate_as)
            continue
        if semantics:
            drawn = draw_semantics(workspace, name, frame)
        elif words is not None:
            drawn = draw_words(workspace, name, frame, split_words(words))
        else:
            drawn = draw_frame(workspace, name, frame)
        for path in drawn:
            print(path)


def _animate(workspace: Workspace, segment: str, kind: str) -> None:
    from rich.console import Console
    from rich.progress import Progress

    from upvl_cli.commands.animate import animate_drive, num_drawn

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task(f"drawing {segment}", total=num_drawn(workspace, segment))
        drawn = animate_drive(workspace, segment, kind, lambda: progress.advance(task))
    thinned = "" if drawn.shown == drawn.frames else f", {drawn.shown} of {drawn.frames} frames"
    print(f"{drawn.path} ({drawn.size_bytes / 1e6:.1f} MB{thinned})")


@app.command("fit-background-threshold")
def fit_threshold(context: typer.Context) -> None:
    """Fit eps_bg, the score from which points are background, to unlabelled drives; draw the histogram."""
    from upvl_cli.commands.fit_background_threshold import fit_background_threshold

    for line in fit_background_threshold(context.obj):
        print(line)


synth = typer.Typer(no_args_is_help=True, help="Look at the built-in drives, which are made up.")
app.add_typer(synth, name="synth")


@synth.command("preview")
def synth_preview(
    context: typer.Context,
    segment: OneSegment = None,
    frame: OneFrame = None,
) -> None:
    """Draw a contact sheet: the cameras, what each pixel is, and the sweep from above."""
    from upvl_cli.commands.synth_preview import preview

    workspace: Workspace = context.obj
    for name in workspace.segments if segment is None else [segment]:
        print(preview(workspace, name, frame))


@synth.command("kinds")
def synth_kinds() -> None:
    """List the kinds of object, with the words that people use for each."""
    from upvl_cli.synthetic.kinds import KINDS

    for kind in KINDS.values():
        print(f"{kind.name}: {', '.join(kind.words)}")
