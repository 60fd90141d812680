"""Table of the commands: each is a row, which ``bundle.cli.run`` runs.

A row has the help, the arguments, and for each kind of INPUT the function of the API that is
called and the function that makes its report. Functions are names, and arguments are declared
when needed, so that a command imports only what it needs, and `bundle --help` hardly anything.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Mapping
from typing import Any

from bundle.io.recognition import Kind, recognize

Name = str | Callable[..., Any]
"""A function, or its name "module:function" within the package."""


class Row:
    """Record with the fields and defaults of its class; a dataclass would slow down the start."""

    def __init__(self, **given: Any) -> None:
        if unknown := given.keys() - type(self).__annotations__.keys():
            raise TypeError(f"{type(self).__name__}: expected its fields, found {sorted(unknown)}")
        vars(self).update(given)


class Way(Row):
    """Steps of a command on one kind of INPUT.

    A way with ``call`` calls the API: ``call(input, options, **keywords)``. A command with ``run``
    does this itself. Words are names of attributes of :class:`bundle.cli.run.Run`, separated by
    blanks.
    """

    call: Name = ""  # function of the API
    stage: str = ""  # name of the step in the progress
    # arguments that are paths, which the API opens itself; otherwise INPUT is opened
    reads: str = ""
    options: str | type[Any] = ""  # option class of ``options``; "": there is none
    # options that can be given and are reported, or a name of them; None: all
    names: str | tuple[str, ...] | None = None
    keywords: str | type[Any] = ""  # option class whose values are keywords
    # keywords that are attributes of the run, in the form "keyword" or "keyword=attribute"
    gives: str = ""
    # arguments of other kinds of INPUT that this kind has, too, beside ``names``; None: ``run``
    # refuses the others
    accepts: str | None = ""
    judges: bool = False  # True to search for findings after the call
    saves: bool = False  # True to write the result to --output, if it is given, by its ``save``
    report: Name = ""  # function that makes the report
    tells: str = "source input found wall"  # attributes of the run that ``report`` gets
    code: Callable[[Any], int] | None = None  # exit code by the result; None: 0
    run: Name = ""  # function of this room that gets the run and returns the report
    main: Name = ""  # function of this room that gets the arguments and returns the exit code
    of: Name = "cli.run:Run"  # class of the run that ``run`` and ``plan`` get
    # function of this room that does the work of --dry-run: it gets the run, checks and reads as
    # ``run`` or ``main`` would, and returns sentences on the predicted cost
    plan: Name = ""


def _detected(arguments: argparse.Namespace) -> str:
    """Detect the kind of INPUT; several inputs are pose graphs if one of them is."""
    paths = [arguments.input] if "input" in arguments else getattr(arguments, "inputs", [])
    kinds = {recognize(path) for path in paths}
    if len(kinds) == 1:
        return kinds.pop()
    return Kind.POSE_GRAPH if Kind.POSE_GRAPH in kinds else Kind.RECONSTRUCTION


class Command(Row):
    """Row of the table."""

    help: str  # purpose of the command
    usage: str = ""  # words after the name in the usage; "": argparse lists all flags
    # function that gets ``bundle.cli.declarations`` and returns the declarations
    arguments: Callable[[Any], tuple[Any, ...]]
    # its steps, by the kind of INPUT. Other kinds go to the reader of reconstructions, whose error
    # names the kind.
    ways: Mapping[str, Way]
    # function that returns the kind
    kind: Callable[[argparse.Namespace], str] = staticmethod(_detected)
    is_for_each: bool = False  # True to run on each of several inputs
    also: str = ""  # other words that users type for the command; its error suggests the command

    def way(self, kind: str) -> Way:
        """Return the steps on a kind of INPUT."""
        return self.ways.get(kind) or self.ways[Kind.RECONSTRUCTION]


def resolve(name: Name) -> Any:
    """Import a function, class or constant by its name."""
    if not isinstance(name, str):
        return name
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(f"bundle.{module}"), attribute)


GRAPH_FILE = "file of a graph"
SHAPE = "numbers of cameras and points"
FLIGHT = "flight"


def _kind_of_inspection(given: argparse.Namespace) -> str:
    if given.shape is not None:
        return SHAPE
    return GRAPH_FILE if given.graph or not given.input else _detected(given)


_OF_GRAPHS = ("error", "information", "loss", "loss_scale", "loss_on")
"""Options that affect the information of a pose graph at its poses."""
_RECORDED = "cli.inertial_flags:RECORDED"
_OF_CHECKS = "samples_per_image all seed tolerance num_threads html"

COMMANDS: dict[str, Command] = {
    "info": Command(
        help="counts, cameras, tracks, reprojection errors [px], and warnings",
        also="stats statistics show describe",
        usage="INPUT... [options]",
        arguments=lambda a: (
            a.given_input("inputs", nargs="+"),
            a.INPUT_FORMAT,
            a.RIG_CONFIG,
            a.RECORDING,
        ),
        is_for_each=True,
        ways={
            Kind.RECONSTRUCTION: Way(run="cli.models:describe_model"),
            Kind.POSE_GRAPH: Way(
                report="reports.terminal.pose_graph_tables:described_graph", tells="source input"
            ),
            Kind.SEQUENCE: Way(run="cli.sequences:describe_sequence", names=_RECORDED),
        },
    ),
    "inspect": Command(
        help="predict nonzeros, fill-in, flops, memory and time per step of each solver",
        also="predict sparsity",
        usage="INPUT [options]\n       bundle inspect --graph FILE [options]",
        arguments=lambda a: (
            a.INSPECTED,
            a.page("report", "also write a page with figures, which needs no network"),
            a.RECALIBRATE,
            a.options("SolveOptions", "what is refined", a.PATTERN),
            a.options("RankOptions", "several processes (docs/mpi.md)"),
            a.options("GraphFileOptions", "a graph in place of a problem"),
            a.options("ShapeOptions", "numbers in place of a problem"),
        ),
        kind=_kind_of_inspection,
        ways={
            Kind.RECONSTRUCTION: Way(run="cli.costs:inspect_model"),
            Kind.POSE_GRAPH: Way(
                run="cli.costs:inspect_pose_graph",
                accepts="ranks network num_threads recalibrate html",
            ),
            GRAPH_FILE: Way(run="cli.costs:inspect_graph_file", accepts=None),
            SHAPE: Way(run="cli.costs:inspect_shape", accepts=None),
        },
    ),
    "refine": Command(
        help="bundle adjustment of a model, or optimisation of a pose graph (.g2o)",
        also="adjust ba bundle_adjuster filter optimize optimise solve",
        usage="INPUT -o OUTPUT [options]",
        arguments=lambda a: (
            a.INPUT,
            a.output("-o", "--output", required=True),
            a.INPUT_FORMAT,
            a.RIG_CONFIG,
            a.options("SolveOptions", "options of the solve"),
            a.COLMAP_OPTIONS,
            a.pose_graph(),
            a.options("RoundOptions", "rounds of adjusting and filtering"),
            a.options("HoldOutOptions", "held-out observations"),
            a.RULES,
            a.measurements(),
            a.IMU,
            a.options("LensOptions", "cameras of OUTPUT"),
            a.options("ShutterOptions", "rolling shutters"),
            a.fields("LocalOptions"),
            a.options("LoopOptions", "loops"),
            a.options("CheckpointOptions", "runs that may be killed"),
            a.options("OutOfCoreOptions", "problems that are larger than the memory"),
            a.page(
                "page",
                "also write a report page, as `bundle report` does, with residuals before and "
                "after; --images DIR has its photographs (default: none)",
            ),
            a.CHECK_GRADIENTS,
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                of="cli.refinement:Refinement", run="cli.refine:refine", plan="cli.refine:plan"
            ),
            Kind.POSE_GRAPH: Way(
                run="cli.models:refine_pose_graph",
                plan="cli.models:plan_pose_graph",
                options="PoseGraphOptions",
                accepts="html",
            ),
        },
    ),
    "compare": Command(
        help="solve from the same start with several solvers, and recommend one",
        also="benchmark",
        usage="INPUT... [options]",
        arguments=lambda a: (
            a.COMPARED,
            a.options("CompareOptions", "what is compared: every combination of", a.METHODS),
            a.EVERY_ORDER,
            a.group(
                "options of the comparison",
                a.fields("CompareOptions", ("perturb", "seed", "repeat", "timeout", "memory_cap")),
                a.page("page", "also write a page with plots"),
            ),
            a.options("SolveOptions", "options of every solve", without=a.compared_options()),
            a.pose_graph(
                ("error", "init", "information", "loss", "loss_on"),
                "pose graphs (.g2o), where backends and threads are compared too",
            ),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(run="cli.costs:compare_models"),
            Kind.POSE_GRAPH: Way(
                run="cli.costs:compare_pose_graph",
                names=(
                    *("error", "init", "information", "loss", "loss_scale", "loss_on"),
                    *("max_num_iterations", "function_tolerance", "gradient_tolerance"),
                    "parameter_tolerance",
                ),
                accepts="backends threads repeat timeout orders html",
            ),
        },
    ),
    "validate": Command(
        help="cross-validate lens models, sharing of cameras and losses, and recommend one",
        also="crossvalidate",
        usage="INPUT [options]",
        arguments=lambda a: (
            a.INPUT,
            a.options(
                "ValidationOptions",
                "candidates: every combination of",
                ("camera_models", "share", "losses", "refine_sets"),
            ),
            a.group(
                "options of the validation",
                a.fields("ValidationOptions", ("num_folds", "seed")),
                a.page("page", "also write a page with the curves"),
            ),
            a.RIG_CONFIG,
            a.options("SolveOptions", "options of every solve", without=("loss", "refine")),
            a.RULES,
            a.measurements(
                "Priors of every fit. The report has the errors at check points and at positions.",
                "--gps exif",
            ),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                call="judging.validation.validate_problem:validate",
                stage="fitting the candidates",
                options="SolveOptions",
                keywords="ValidationOptions",
                gives="priors constraints source flags progress=share",
                report="reports.terminal.judged:validated",
                tells="source input found settings",
            )
        },
    ),
    "check": Command(
        help="check the analytic Jacobians of this problem, or of your own factors "
        "(FILE.py:NAME), and name mistakes",
        also="gradients jacobians",
        arguments=lambda a: (
            a.INPUT,
            a.group(
                "options of the check",
                a.either(a.fields("CheckOptions", ("samples_per_image",)), a.ALL),
                a.fields("CheckOptions", ("seed", "tolerance", "num_threads")),
                a.page(
                    "page", "also write a page: wrong entries, and curves against the step size"
                ),
            ),
            a.pose_graph(("error",), "pose graphs (.g2o)"),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(run="cli.costs:check_model"),
            Kind.POSE_GRAPH: Way(run="cli.costs:check_pose_graph", accepts=f"error {_OF_CHECKS}"),
            Kind.PYTHON: Way(run="cli.costs:check_object", accepts=_OF_CHECKS),
        },
    ),
    "covariance": Command(
        help="marginal covariances of poses, points and intrinsics, or of the poses of a "
        "pose graph",
        also="uncertainty",
        usage="INPUT -o FILE.npz [options]",
        arguments=lambda a: (
            a.INPUT,
            a.ARRAYS,
            a.options("CovarianceOptions", "what is wanted"),
            a.options("SolveOptions", "what is refined, as in the solve", a.INFORMATION),
            a.RULES,
            a.measurements(
                "The priors with which `bundle refine` made INPUT, by the same flags. INPUT is not "
                "moved.",
                "--gps exif",
            ),
            a.pose_graph(
                ("error", "information", "loss", "loss_on"),
                "pose graphs (.g2o), beside the loss",
            ),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                call="analysis.uncertainty.covariance_by_input:covariance",
                stage="inverting",
                options="SolveOptions",
                names="interface.options:INFORMATION",
                keywords="CovarianceOptions",
                gives="priors constraints",
                saves=True,
                report="reports.terminal.analyses:uncertainties",
                tells="source input found asked target wall",
            ),
            Kind.POSE_GRAPH: Way(
                call="analysis.uncertainty.graph_covariance:graph_covariance",
                stage="inverting",
                options="PoseGraphOptions",
                names=_OF_GRAPHS,
                keywords="CovarianceOptions",
                accepts="relative gauge scale num_threads",
                saves=True,
                report="reports.terminal.analyses:uncertainties",
                tells="source input found asked target wall",
            ),
        },
    ),
    "diagnose": Command(
        help="find undetermined parameters of a model or pose graph: rank, weak directions, "
        "components, suspicious edges; errors that would go unnoticed",
        also="gauge rank redundancy reliability",
        usage="INPUT [options]",
        arguments=lambda a: (
            a.INPUT,
            a.RIG_CONFIG,
            a.options("SolveOptions", "what would be refined", a.LINEARIZATION),
            a.RELIABILITY_ARRAYS,
            a.options("ReliabilityOptions", "errors that would go unnoticed"),
            a.page("page", "also write a page; with --reliability, redundancy over the images"),
            a.RULES,
            a.measurements(
                "Priors of a refinement with the same flags. The model is examined in metres "
                "about the middle of the control points, or of the positions if there are no "
                "control points.",
                "--gps exif",
            ),
            a.pose_graph(
                ("error", "information", "loss", "loss_on"),
                "pose graphs (.g2o), beside loss and threads",
            ),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                call="analysis.diagnosis.diagnose_problem:diagnose",
                stage="diagnosing",
                options="SolveOptions",
                names="interface.options:LINEARIZATION",
                keywords="ReliabilityOptions",
                gives="priors constraints",
                judges=True,
                saves=True,
                report="reports.terminal.analyses:diagnosed",
                tells="source input found asked wall findings",
            ),
            Kind.POSE_GRAPH: Way(
                call="analysis.diagnosis.diagnose_graph:diagnose_graph",
                stage="diagnosing",
                options="PoseGraphOptions",
                names=_OF_GRAPHS,
                accepts="num_threads html",
                report="reports.terminal.analyses:diagnosed",
                tells="source input found asked wall",
            ),
        },
    ),
    "influence": Command(
        help="what a length, height, angle, volume or camera parameter depends on, and its value "
        "without each observation, point or image",
        also="derivative jackknife sensitivity",
        usage="INPUT --on QUANTITY [options]",
        arguments=lambda a: (
            a.INPUT,
            a.RIG_CONFIG,
            a.options("InfluenceOptions", "the quantity"),
            a.options("SolveOptions", "what is refined, as in the solve", a.INFORMATION),
            a.RULES,
            a.measurements(
                "The priors of the solve, by the same flags; control points can be named in the "
                "quantity.",
                "--gps exif",
            ),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                call="analysis.uncertainty.influence:influence",
                stage="differentiating",
                options="SolveOptions",
                names="interface.options:INFORMATION",
                keywords="InfluenceOptions",
                gives="priors constraints",
                report="reports.terminal.analyses:influenced",
                tells="source input found asked wall",
            ),
        },
    ),
    "plan": Command(
        help="what to measure next for a length, height, angle, volume or camera parameter: the "
        "image, tie, control point or scale bar that lowers its sigma most",
        also="network design next best view optimal",
        usage="INPUT --for QUANTITY [--add LIST] [options]",
        arguments=lambda a: (
            a.INPUT,
            a.RIG_CONFIG,
            a.options(
                "PlanOptions",
                "the quantity, and what could be added",
                ("on", "add", "count", "candidates", "bar_sigma"),
            ),
            a.options("SolveOptions", "what is refined, as in the solve", a.INFORMATION),
            a.RULES,
            a.measurements(
                "The priors of the solve; --gcp-sigma also holds for new control points.",
                "--gps exif",
            ),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                call="analysis.uncertainty.measurement_plan:plan",
                stage="planning",
                options="SolveOptions",
                names="interface.options:INFORMATION",
                keywords="PlanOptions",
                gives="priors constraints",
                report="reports.terminal.analyses:planned",
                tells="source input found asked repeated wall",
            ),
        },
    ),
    "align": Command(
        help="georeference a model by GPS or control points, or align it to another model",
        also="georegister georeference register model_aligner",
        usage="INPUT -o OUTPUT [--gcp FILE] [--gps exif|FILE] [options]",
        arguments=lambda a: (
            a.INPUT,
            a.output("-o", "--output", required=True),
            a.placing(),
            a.group("another model", a.ALIGNED_TO),
            a.options("GeoreferenceOptions", "robustness", a.ROBUST),
        ),
        ways={Kind.RECONSTRUCTION: Way(run="cli.models:align_model")},
    ),
    "merge": Command(
        help="merge two models that share images",
        also="join model_merger",
        usage="A B -o OUTPUT [options]",
        arguments=lambda a: (
            a.a_model("a", "a COLMAP model, whose frame, poses and ids stay"),
            a.a_model("b", "a COLMAP model with some images of the same names"),
            a.output("-o", "--output", required=True, replaces=("a", "b")),
            a.MERGE_ERROR,
        ),
        ways={Kind.RECONSTRUCTION: Way(run="cli.models:merge_models")},
    ),
    "evaluate": Command(
        help="errors of a model or trajectory A against a reference: truth, or another model",
        also="ape rpe evo",
        usage="A --reference B [options]",
        arguments=lambda a: (
            a.EVALUATED,
            a.TRUTH,
            a.options("EvaluateOptions", "options of the comparison"),
            a.page("page", "also write a page with errors per image, paths from above and lenses"),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                call="judging.evaluation.evaluate_models:evaluate",
                reads="a b",
                stage="comparing",
                options="EvaluateOptions",
                report="reports.terminal.judged:evaluated",
                tells="source found options",
            )
        },
    ),
    "report": Command(
        help="write a page (HTML, no network) on a model or pose graph: verdicts, residuals, "
        "worst images or edges, a 3-D view",
        also="html page",
        usage="INPUT -o FILE.html [options]",
        arguments=lambda a: (
            a.INPUT,
            a.PAGE_OUTPUT,
            a.RIG_CONFIG,
            a.options("SolveOptions", "loss with which INPUT was made", ("loss", "loss_scale")),
            a.RULES,
            a.measurements(
                "The priors with which `bundle refine` made INPUT, by the same flags: standard "
                "deviations depend on them. INPUT is not moved.",
                "--gps exif and residuals of the worst images on their photographs",
            ),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(run="cli.models:report_model"),
            Kind.POSE_GRAPH: Way(run="cli.models:report_pose_graph"),
        },
    ),
    "triage": Command(
        help="name the cause of the difference between two reports of one input: ordering, fill, "
        "prior, Jacobian, machine, data, options or convergence",
        also="diff",
        usage="OLD.json NEW.json [options]",
        arguments=lambda a: (
            a.a_report("old", "earlier"),
            a.a_report("new", "later"),
            a.options("TriageOptions", "noise"),
        ),
        ways={
            Kind.RECONSTRUCTION: Way(
                call="judging.triage.triage_reports:triage",
                reads="old new",
                options="TriageOptions",
                report="reports.terminal.judged:triaged",
                tells="source found options",
                code=lambda found: 0 if found.is_noise else 1,
            )
        },
    ),
    "vio": Command(
        help="visual-inertial odometry from images, a recording or feature tracks, and IMU samples",
        also="odometry slam",
        usage="SEQUENCE -o FILE.tum [options]",
        arguments=lambda a: (
            *a.ODOMETRY,
            a.RECORDING,
            a.options("WindowOptions", "the window"),
        ),
        ways={Kind.RECONSTRUCTION: Way(run="cli.sequences:run_vio")},
    ),
    "convert": Command(
        help="convert between formats, and list what is lost",
        also="export import model_converter",
        arguments=lambda a: (
            a.INPUT,
            a.output("output"),
            a.INPUT_FORMAT,
            a.RIG_CONFIG,
            a.RECORDING,
            a.options("LensOptions", "cameras of OUTPUT"),
            a.GLOBAL_SHUTTER,
        ),
        ways={
            Kind.RECONSTRUCTION: Way(run="cli.models:convert_model"),
            Kind.POSE_GRAPH: Way(run="cli.models:convert_pose_graph"),
            Kind.SEQUENCE: Way(run="cli.sequences:convert_sequence", names=_RECORDED),
        },
    ),
    "synth": Command(
        help="make a seeded scene with ground truth, from toy to millions of observations",
        also="generate simulate synthesize",
        arguments=lambda a: (
            *a.SCENE_OUTPUTS,
            a.options("SceneOptions", "options of the scene"),
            a.FLIGHTS,
        ),
        kind=lambda given: FLIGHT if given.scene == FLIGHT else Kind.RECONSTRUCTION,
        ways={
            Kind.RECONSTRUCTION: Way(run="cli.scenes:make_scene"),
            FLIGHT: Way(run="cli.scenes:make_flight", accepts=None),
        },
    ),
    "demo": Command(
        help="refine a small scene that comes with the package, and write a report page",
        usage="[FOLDER] [options]",
        arguments=lambda a: (a.DEMO_FOLDER,),
        ways={Kind.RECONSTRUCTION: Way(main="cli.scenes:demo")},
    ),
}
"""Commands in the order of the help."""
