"""Commands that show drives and labels."""

from __future__ import annotations

from typing import Annotated

import typer

from upvl_cli.cli.application import OneFrame, OneSegment, app
from upvl_cli.errors import BadInput
from upvl_cli.pipeline.workspace import Workspace


@app.command()
def draw(
    context: typer.Context,
    segment: OneSegment = None,
    frame: OneFrame = None,
    words: Annotated[
        str | None, typer.Option(help='Colour each point by its nearest word: "car, tree, person".')
    ] = None,
) -> None:
    """Draw points, boxes and tracks from above, and boxes on the camera's picture."""
    from upvl_cli.commands.draw import draw_frame
    from upvl_cli.commands.draw_words import draw_words, split_words

    workspace: Workspace = context.obj
    for name in workspace.segments if segment is None else [segment]:
        workspace.check_name(name, workspace.segments)
        drawn = (
            draw_frame(workspace, name, frame)
            if words is None
            else draw_words(workspace, name, frame, split_words(words))
        )
        for path in drawn:
            print(path)


@app.command("fit-background-threshold")
def fit_threshold(context: typer.Context) -> None:
    """Fit eps_bg, the score from which points are background, to unlabelled drives; draw the histogram."""
    from upvl_cli.commands.fit_background_threshold import fit_background_threshold

    for line in fit_background_threshold(context.obj):
        print(line)


@app.command("check")
def check_drive(context: typer.Context, segment: OneSegment = None) -> None:
    """Look for faults of a drive before it is labelled: its times, its pictures, the calibration of its cameras."""
    from upvl_cli.commands.check import check

    workspace: Workspace = context.obj
    faulty = []
    for name in workspace.segments if segment is None else [segment]:
        workspace.check_name(name, workspace.segments)
        print(name)
        for finding in check(workspace, name):
            print(f"  {'FAULT ' if finding.is_fault else ''}{finding.sentence}")
            faulty += [f"{name}: {finding.sentence}"] if finding.is_fault else []
    if faulty:
        raise BadInput(f"{len(faulty)} faults found, the first: {faulty[0]}")


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
