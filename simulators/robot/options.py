"""How one controller is set up, and what is not known for certain about all of them: each open question an option."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args, get_origin, get_type_hints

from simulators.robot.codes import code_by_text


@dataclass(frozen=True)
class Options:
    """Defaults are what recorded conversations and manuals say, or where they are silent what most clients expect.

    `None` leaves a choice to the generation: an RCX240 starts with its servos on, an RCX340 does not; only a
    controller whose network port is 23 speaks telnet and echoes.
    """

    # -- parameters of the robot
    pulse_scale: float = 1.0  # nobody has published the pulse ratios of the XG
    soft_limit_margin_deg: float = 0.0  # by which the soft limits of the arms lie inside their range
    # -- at power on
    servo_at_start: bool | None = None
    origin_at_start: bool = True
    # -- replies
    padded_codes: bool = False  # NG=06.204
    almrst: Literal["run", "ok"] = "run"
    servo_reply: Literal["run", "ok"] = "run"
    after_stop: Literal["ng", "end"] = "ng"  # how a move ends that ^C stopped
    errors: Literal["text", "ng"] = "text"  # of an RCX240: 5.52:words or NG=5.52
    language: Literal["english", "japanese"] = "english"  # of those words
    where_fields: Literal[6, 9] = 6
    position_fields: Literal[6, 7, 9] = 9
    version: str | None = None
    config: str | None = None
    busy: str = "6.282"  # the code for a motion while another runs
    latching_alarms: bool = True  # serious ones need the power off and on again
    when_moving: Literal["wait", "refuse"] = "wait"  # an RCX240's answer to a line that comes while it moves
    # -- the line
    greeting: str | None = None
    telnet: bool | None = None  # negotiates when a client connects
    echo: bool | None = None  # sends back what it hears
    flow: Literal["xonxoff", "none"] = "xonxoff"  # of the serial line
    second_client: Literal["close", "serve"] = "close"
    on_disconnect: Literal["stop", "continue"] = "stop"
    lost_link_refusal: bool = False  # the first command after a lost link is refused with 14.400
    keep_alive_s: float = 15.0  # an RCX240's network unit: a dead link is noticed after so long; 0 = never
    silence_min: float = 10.0  # and a silent client is hung up on after so long; 0 = never
    dialogue: Literal["pendant", "line"] = "pendant"  # where programs print, and who answers their INPUT
    # -- motion and outputs
    ends_at: Literal["arrival", "tolerance", "outpos"] = "arrival"  # when a motion counts as done: END, or OK
    brake_sag_mm: float = 0.0  # by which the third axis sinks until its brake holds it
    free_z_mm_per_s: float = 50.0  # at which it sinks while its brake is released
    dead_man_s: float = 0.2
    outputs_on_emergency: Literal["hold", "clear"] = "hold"

    def __post_init__(self) -> None:
        """Raises ValueError for a code that there is not."""
        code_by_text(self.busy)


def with_settings(options: Options, settings: Sequence[str]) -> Options:
    """The options changed by `name=value` texts; raises ValueError that names what can be set."""
    kinds = get_type_hints(Options)
    changed: dict[str, object] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or name not in kinds:
            raise ValueError(f"{setting!r} is no option: write NAME=VALUE with one of {', '.join(kinds)}")
        changed[name] = _value(name, value, kinds[name])
    return replace(options, **changed)  # type: ignore[arg-type]


def _value(name: str, text: str, kind: Any) -> object:
    if get_origin(kind) is Literal:
        return _choice(name, text, {str(choice): choice for choice in get_args(kind)})
    if kind is bool or bool in get_args(kind):
        return _choice(name, text, {"true": True, "false": False, "1": True, "0": False})
    if kind is float:
        try:
            return float(text)
        except ValueError:
            raise ValueError(f"option {name}: {text!r} is no number") from None
    return text


def _choice(name: str, text: str, choices: dict[str, object]) -> object:
    if text not in choices:
        raise ValueError(f"option {name}: {text!r} is none of {', '.join(choices)}")
    return choices[text]
