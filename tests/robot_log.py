"""What a controller's own log says about its client: the invariants of a driver, whatever went wrong."""

OPERATIONS = ("@MOVE", "@MOTOR", "@SERVO", "@ALMRST", "@EMGRST", "@ORIGIN", "@ABSRST", "@JOG", "@INCH")
BUSY = ("0.5", "0.8")  # the motion was not begun, and may be asked for again
KINDS = ("joined", "left", "heard", "said", "power", "alarm", "moves")


def moves_heard(log):
    """The motions that were asked for."""
    return [entry.line for entry in log.of("heard") if entry.line.startswith("@MOVE")]


def check_one_at_a_time(log, *, queries_end_by_ok):
    """At most one question and one operation are open at a time, since the client came (network only)."""
    question = operation = None
    for entry in log.of(*KINDS):
        if entry.kind in ("joined", "left"):
            question = operation = None
        elif entry.kind == "heard" and entry.line.startswith("@"):
            if entry.line.startswith(OPERATIONS):
                assert operation is None, f"{entry.line} while {operation} is under way"
                assert question is None, f"{entry.line} while {question} is not answered"
                operation = entry.line
            else:
                assert question is None, f"{entry.line} while {question} is not answered"
                assert queries_end_by_ok or operation is None, f"{entry.line} while {operation} is under way"
                question = entry.line
        elif entry.kind == "said":
            question, operation = _after(entry.line, question, operation, queries_end_by_ok)


def check_positions_are_read_back(log):
    """Between two motions the position is asked, unless the first one blends into the second."""
    asked = True
    for entry in log.of("heard", "joined", "refused"):
        if entry.kind == "joined":
            asked = False
        elif entry.kind == "refused":
            asked = asked or entry.code.rcx3 in BUSY
        elif entry.line.startswith("@?WHRXY"):
            asked = True
        elif entry.line.startswith("@MOVE"):
            assert asked, f"{entry.line} without knowing where the arm stands"
            asked = "CONT" in entry.line


def check_still_after_alarms(log):
    """From an alarm until somebody resets it, no motion is asked for beyond the line that was on its way."""
    alarmed, sent = False, 0
    for entry in log.of("alarm", "heard"):
        if entry.kind == "alarm":
            alarmed, sent = entry.code is not None, 0
        elif alarmed and entry.line.startswith(("@MOVE", "@JOG", "@INCH")):
            sent += 1
            assert sent <= 1, f"{entry.line} after an alarm that nobody has reset"


def check(log, *, dialect):
    """All of them."""
    check_one_at_a_time(log, queries_end_by_ok=dialect == "rcx3")
    check_positions_are_read_back(log)
    check_still_after_alarms(log)


def _after(line, question, operation, queries_end_by_ok):
    if line in ("RUN", "BEGIN", "READY"):
        return question, operation
    if not queries_end_by_ok:
        return None, None
    if line == "END":
        return (question, None) if operation is not None else (None, None)
    if line == "OK" and question is not None:
        return None, operation
    if line.startswith("NG") and operation is not None and question is None:
        return question, None
    if line.startswith("NG"):
        return None, None if line.startswith(("NG=1.", "NG=12.", "NG=17.")) else operation
    return question, operation
