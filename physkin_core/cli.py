"""The `physkin` command. Subcommands import what they need when they run: `physkin info` needs no ROS and no torch."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path

import numpy as np

from physkin_core import AvatarWarning, Outfit, load_body_model, load_garment_model
from physkin_core.completion import SHELLS, completion_script
from physkin_core.extras import extra_of, install_command
from physkin_core.mesh.look import Look
from physkin_core.mesh.mesh_file import write_obj
from physkin_core.model.model_file import split_fabric
from physkin_core.motion.clip_files import describe_clips, is_clip
from physkin_core.outfit.outfit_options import add_options, as_asked, dressed, read_motion
from physkin_core.output_file import check_folder, check_other_file
from physkin_core.pictures.picture import PictureError, render, save_png
from physkin_core.progress import progress_line

__all__ = ["main"]

COMMANDS = {
    "look at clothes on an avatar": {
        "view": ("physkin_core.view.view", "show an avatar and its outfit live, on a page in the browser"),
        "check": ("physkin_core.check.check", "tell how garments sit on an avatar: a verdict, figures, a picture"),
        "render": ("physkin_core.render.render", "film a draped motion: .mp4, .gif, .webp or numbered .png"),
        "drape": ("", "drape one frame of a motion, and write a mesh or a picture"),
    },
    "take them elsewhere": {
        "export": ("physkin_core.export.export", "write a draped motion as glTF (.glb) or USD, for other tools"),
        "drape-many": (
            "physkin_core.cluster.drape_many",
            "drape many motions on many avatars, on a Ray cluster: arrays, .glb or USD",
        ),
        "bind": ("", "write garments on one avatar for hosts without Python (a browser, Unity, C, C++)"),
        "bind-points": (
            "physkin_core.points.bind_points",
            "drape another mesh, a point cloud or Gaussian splats that lie on a garment",
        ),
    },
    "ROS 2": {
        "node": ("physkin_ros.node.node_process", "run the ROS 2 node: joint states in, garment point clouds out"),
        "demo": (
            "physkin_ros.tools.demo",
            "play a motion to the node for ten seconds, measure what comes back, draw it",
        ),
        "replay": (
            "physkin_ros.replay.command",
            "drape the joint states of a bag, and write clouds, figures and a report; needs no ROS",
        ),
        "convert": ("physkin_ros.replay.convert", "write a motion clip, BVH or AMC file as a bag of joint states"),
    },
    "garments of your own": {
        "fit-garment": (
            "physkin_training.fit_garment.fit_garment",
            "check and train a garment of your own, and write a report",
        ),
        "train": ("physkin_training.train.train", "train a garment from its mesh and physics"),
        "train-catalogue": (
            "physkin_training.catalogue.train_catalogue",
            "run fit-garment on every garment of a folder, on a Ray cluster",
        ),
        "learn-sway": (
            "physkin_training.sway.command",
            "teach a garment to lag, swing and settle, from simulated walkers",
        ),
    },
    "measure garments": {
        "evaluate": (
            "physkin_training.evaluate.command",
            "measure a garment model or outfits on bodies that training has not seen",
        ),
        "contact-sheet": (
            "physkin_training.evaluate.contact_sheet",
            "draw a garment model on a lean, an average and a stout body",
        ),
        "simulate": ("physkin_training.evaluate.simulate", "drape a garment on an avatar by minimising its energy"),
        "info": ("", "show what a garment model or a motion file holds"),
    },
    "this installation": {
        "doctor": ("physkin_core.doctor.doctor", "check this installation, and tell what to do if something is wrong"),
        "bench": ("physkin_core.bench", "measure how long a frame takes on this machine, and count its bytes"),
        "completion": ("", "print the completion script of a shell"),
    },
}
"""What for -> subcommand -> module whose `main(argv)` it calls, empty where it is one of this file, and what it
does."""
TEXTS = {name: text for names in COMMANDS.values() for name, (_, text) in names.items()}
FORWARDED = {name: module for names in COMMANDS.values() for name, (module, _) in names.items() if module}

DEBUG = "--debug"
PICTURE_SIZE = (800, 1000)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line. Returns the exit status: 0, 2 after an error that the user can mend, 1 after one of ours (and where
    a command says so); both print one line, unless `--debug` is among the arguments."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    ours = arguments[: arguments.index("--ros-args")] if "--ros-args" in arguments else arguments
    if debug := DEBUG in ours:
        arguments.remove(DEBUG)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AvatarWarning)  # commands print or log what `Avatar.warnings` holds
        try:
            return _run(arguments)
        except KeyboardInterrupt:
            return 130
        except BrokenPipeError:  # the reader of our output has gone, as `head` does
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except Exception as error:
            if debug:
                raise
            return _report(error, arguments)


def _run(arguments: list[str]) -> int:
    try:
        if arguments and arguments[0] in FORWARDED:
            status = import_module(FORWARDED[arguments[0]]).main(arguments[1:]) or 0
        else:
            options = _parser().parse_args(arguments or ["--help"])
            status = options.run(options)
    except SystemExit:  # after help
        sys.stdout.flush()
        raise
    sys.stdout.flush()  # at Python's own end it would be too late to notice that nobody reads it any more
    return status


def _report(error: Exception, arguments: list[str]) -> int:
    """Say what went wrong, and what to do. Returns the exit status."""
    extra = extra_of(error.name) if isinstance(error, ModuleNotFoundError) else None
    if extra is not None:
        print(f"error: {error}; physkin {arguments[0]} needs: {install_command(extra)}", file=sys.stderr)
    elif isinstance(error, ValueError | OSError | PictureError):  # the core's own errors are ValueErrors
        print(f"error: {error}", file=sys.stderr)
    else:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        print(f"error: {said}; this should not happen: physkin {DEBUG} shows where, please report it", file=sys.stderr)
        return 1
    return 2


class _GroupedParser(argparse.ArgumentParser):
    """Lists the subcommands by what they are for."""

    def format_help(self) -> str:
        """Text of --help."""
        first = 2 + max(map(len, TEXTS)) + 2
        wide = max(shutil.get_terminal_size().columns - 2, 2 * first)
        lines = [self.format_usage(), self.description]
        for title, texts in COMMANDS.items():
            lines += ["", f"{title}:"]
            for name, (_, text) in texts.items():
                lines += textwrap.wrap(
                    text, wide, initial_indent=f"  {name}".ljust(first), subsequent_indent=" " * first
                )
        return "\n".join(
            [
                *lines,
                "",
                "to begin with: physkin view -g trousers -g tshirt",
                f"physkin COMMAND --help lists the options of a command. {DEBUG} shows where an error was raised.",
                "",
            ]
        )


def _parser(forwarded: Mapping[str, argparse.ArgumentParser] | None = None) -> argparse.ArgumentParser:
    """forwarded: options of commands that have their own parser, where they are to be known, too."""
    parser = _GroupedParser(prog="physkin", description="Clothes for any avatar, live, on one CPU core.")
    parser.add_argument(DEBUG, action="store_true", help="show where an error was raised")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=argparse.ArgumentParser)
    for name in FORWARDED:
        parents = [forwarded[name]] if forwarded and name in forwarded else []
        commands.add_parser(name, help=TEXTS[name], add_help=False, parents=parents)

    def command(name: str, run: Callable[[argparse.Namespace], int], *parents: argparse.ArgumentParser):
        own = commands.add_parser(name, parents=parents, help=TEXTS[name], description=TEXTS[name])
        own.set_defaults(run=run)
        return own

    worn = argparse.ArgumentParser(add_help=False)
    worn.add_argument("avatar", metavar="AVATAR", help="avatar: a GLB, glTF, VRM, FBX, OBJ, PLY or STL file")
    add_options(worn, "garment", "rig", "bones", "fit", "tucked")
    drape = command("drape", _drape, worn)
    drape.add_argument("--motion", default="walk", help="bundled motion or a motion file (default %(default)s)")
    drape.add_argument("--frame", type=int, default=0, metavar="K", help="frame of the motion (default %(default)s)")
    drape.add_argument(
        "--strip", type=int, metavar="N", help="draw N frames instead, evenly spread, from the front and the back"
    )
    add_options(drape, "source-rate", "separate-limbs", "own-clothes")
    drape.add_argument("-o", "--output", type=Path, required=True, help="body and garments as .obj, or a .png picture")
    bind = command("bind", _bind, worn)
    bind.add_argument(
        "-o", "--output", type=Path, required=True, help="file to write, such as me.physkin (docs/c-host.md)"
    )
    info = command("info", _info)
    info.add_argument("model", help="garment model file, or the name of a shipped one; or a file with clips")
    command("completion", _complete).add_argument("shell", choices=SHELLS)
    return parser


def _drape(options: argparse.Namespace) -> int:
    from physkin_core.render.filming import draw_strip, dressed_meshes

    path, is_strip = options.output, options.strip is not None
    kind = path.suffix.lower()
    if kind not in (allowed := (".png",) if is_strip else (".obj", ".png")):
        raise ValueError(f"cannot write {path}: the name{' of a strip' * is_strip} must end in {' or '.join(allowed)}")
    check_folder(path)
    check_other_file(path, options.avatar)
    motion = read_motion(options)
    outfit = dressed(options)
    motion = as_asked(motion, options, outfit)
    if is_strip:
        save_png(path, draw_strip(outfit, motion, options.strip, watch=progress_line(f"drawing {path.name}")))
    else:
        positions = motion.positions_for(outfit.rig)[options.frame]
        cloth, body = outfit.drape(positions, motion.gravity[options.frame]), outfit.posed_body(positions)
        if kind == ".png":
            save_png(path, render(dressed_meshes(outfit, body, cloth), size=PICTURE_SIZE))
        else:
            _write_obj(path, outfit, body, cloth)
    print(f"wrote {path}")
    return 0


def _bind(options: argparse.Namespace) -> int:
    check_other_file(options.output, options.avatar, *(split_fabric(name)[0] for name in options.garment or ()))
    dressed(options).save_bound(options.output)
    print(f"wrote {options.output}: {options.output.stat().st_size / 1e6:.1f} MB")
    return 0


def _write_obj(path: Path, outfit: Outfit, body: np.ndarray, cloth: Sequence[np.ndarray]) -> None:
    """A Wavefront OBJ with the object `body` and one a garment, metres, Z up. One garment is called `garment`."""
    from trimesh.util import append_faces

    names = [layer.name for layer in outfit.layers] if len(cloth) > 1 else ["garment"]
    faces = [outfit.body_to_draw.faces, *(layer.faces for layer in outfit.layers)]
    part = np.repeat(np.arange(len(faces)), list(map(len, faces)))
    look = replace(Look.plain(len(part)), part=part, parts=("body", *names))
    write_obj(path, *append_faces([body, *(cloud[:, :3] for cloud in cloth)], faces), look, header="PhySkin")


def _info(options: argparse.Namespace) -> int:
    if is_clip(options.model) and (clips := describe_clips(options.model, load_body_model().rig)):
        return _print_rows(clips)
    model = load_garment_model(options.model)
    garment, rig = model.garment, model.rig
    sizes = {
        network: " -> ".join(str(size) for size in [layers[0][0].shape[1], *(len(weight) for weight, _ in layers)])
        for network, layers in (("pose modulator", model.pose_modulator), ("node deformer", model.node_deformer))
    }
    parameters = sum(array.size for name, array in model.arrays().items() if "modulator" in name or "deformer" in name)
    rows = {
        "name": model.name,
        "garment": f"{len(garment.vertices)} vertices, {len(garment.faces)} faces, {garment.face_areas.sum():.3f} m2",
        "rest shape": "as its mesh lies" if garment.panel_places is None else "the flat panels that it was cut from",
        "garment nodes": f"{len(model.node_rest)}, {model.influence_nodes.shape[1]} influences a vertex",
        "sway": "by its sway network" if model.sway is not None else "none: it has no sway network",
        "rig": f"{rig.bone_count} bones, {len(rig.dofs)} joints",
        "joints": ", ".join(rig.joint_names),
        **sizes,
        "network weights": parameters,
        "material": json.dumps(asdict(model.material)),
        "training": json.dumps(dict(model.training), indent=2),
        "scores": json.dumps(dict(model.scores), indent=2),
    }
    return _print_rows(rows)


def _print_rows(rows: Mapping[str, object]) -> int:
    width = max(map(len, rows))
    print("\n".join(f"{name:<{width}}  {value}" for name, value in rows.items()))
    return 0


def _complete(options: argparse.Namespace) -> int:
    parsers = {}
    for name, module in FORWARDED.items():
        try:
            command = import_module(module)
            if hasattr(command, "command_parser"):
                parsers[name] = command.command_parser()
        except ImportError:  # an extra that is not installed: its command is completed, its options are not
            continue
    print(completion_script(_parser(parsers), options.shell))
    return 0


if __name__ == "__main__":
    sys.exit(main())
