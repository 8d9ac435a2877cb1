"""What a session changes: components, connections, whole systems. Each is one request, and ``dry_run`` only answers what would be done.

Invariant: nothing is decided here: the GCM refuses or does it, and the session's own copy of the graph has seen it on return.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from . import _proto, _system_file, _values
from ._errors import TrocarError, invalid
from ._graph import Graph
from ._paths import path_of
from ._place import Place
from ._proxy import Interface
from ._show import Answer, clean
from ._wire import Wire

_PATIENCE = 10.0
_WHOLE = 60.0
"""For a whole system, s."""


def named(verb: str, paths: tuple[Any, ...]) -> list[str]:
    """The components that a verb is for."""
    __tracebackhide__ = True
    if not paths:
        raise invalid(f'{verb}: name components, e.g. "host/robot" or "host/**"', field="paths")
    return [p if isinstance(p, str) else path_of(p, (2,)) for p in paths]


class Changing:
    """The verbs of ``Session`` that change the system."""

    _wire: Wire
    _graph: Graph
    _place: Place

    def _say(self, text: str) -> None: ...

    def create(
        self,
        path: Any,
        class_: str,
        config: Mapping[str, Any] | None = None,
        execution: Mapping[str, Any] | None = None,
        *,
        isolation: str = "",
        dry_run: bool = False,
    ) -> Answer:
        """Makes a component: ``ire.create("host/robot", "eyerobot", {"seed": 7}, {"rate_hz": 1000})``."""
        __tracebackhide__ = True
        fields: dict[str, Any] = {"class": class_, "path": path_of(path, (2,)), "isolation": isolation}
        return self._change("Create", fields, config, execution, dry_run)

    def configure(
        self,
        path: Any,
        config: Mapping[str, Any] | None = None,
        execution: Mapping[str, Any] | None = None,
        *,
        dry_run: bool = False,
        **settings: Any,
    ) -> Answer:
        """Changes settings of a component: what is given is merged into what it has, ``None`` gives a key its default."""
        __tracebackhide__ = True
        merged = {**(config or {}), **settings} if config is not None or settings else None
        return self._change("Configure", {"path": path_of(path, (2,))}, merged, execution, dry_run)

    def start(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Starts components, servers before clients; globs like ``"host/**"`` too. From STOPPED this is a fresh start."""
        __tracebackhide__ = True
        return self._each("Start", paths, dry_run)

    def stop(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Stops components; their devices are made safe. Asked at a host of this user, it goes by a socket of its own and waits for
        no other call; ``trocar.stop`` needs no session.
        """
        __tracebackhide__ = True
        return self._each("Stop", paths, dry_run)

    def resume(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Lets stopped components go on with the state they had."""
        __tracebackhide__ = True
        return self._each("Resume", paths, dry_run)

    def reset(self, *paths: Any, dry_run: bool = False) -> Answer:
        """Makes components anew, from FAULT to READY."""
        __tracebackhide__ = True
        return self._each("Reset", paths, dry_run)

    def remove(self, path: Any, *, force: bool = False, dry_run: bool = False) -> Answer:
        """Destroys a component; ``force`` stops and disconnects it first."""
        __tracebackhide__ = True
        return self._change("Remove", {"path": path_of(path, (2,)), "force": force}, None, None, dry_run)

    def forget(self, process: str, *, dry_run: bool = False) -> Answer:
        """Takes a process that has ended off the list, with its components."""
        __tracebackhide__ = True
        return self._change("Forget", {"process": process}, None, None, dry_run)

    def restart(self, process: str, *, timeout: float = 30.0) -> int:
        """Ends a process that ``trocar up`` keeps and starts it again, also one that is FAILED; what moves something comes back
        STOPPED. Answers the number of the incarnation that runs then.
        """
        __tracebackhide__ = True
        answer = self._wire.call("GcmService/Restart", _proto.message("RestartRequest")(process=process), timeout)
        self._seen(answer.revision)
        return int(answer.epoch)

    def connect(self, client: Any, server: Any, *, dry_run: bool = False, **options: Any) -> Answer:
        """Connects a required interface or input to a provided interface or output.

        ``options`` as in a system file: ``queue={"fifo": 8}``, ``max_age_ms``, ``deadline_ms``, ``mailbox``, ``adapt``, ``delay``,
        ``carrier``, and ``replace=True``.
        """
        __tracebackhide__ = True
        fields: dict[str, Any] = {"client": path_of(client, (3,)), "server": path_of(server, (3,))}
        if options:
            fields["options"] = _system_file.connect_options(options, "connect")
        return self._change("Connect", fields, None, None, dry_run)

    def disconnect(self, client: Any, server: Any = None, *, dry_run: bool = False) -> Answer:
        """Takes a connection away: by its number, its two ends, one end where that is enough, or the proxy that uses it."""
        __tracebackhide__ = True
        fields: dict[str, Any] = {}
        if isinstance(client, bool) or (isinstance(client, int) and client <= 0):
            raise invalid(f"connection {client!r}: give a number of `tree`, or its ends", field="id")
        if isinstance(client, int):
            fields["id"] = client
        elif isinstance(client, Interface) and client._connection:
            fields["id"] = client._connection
        else:
            fields["client"] = path_of(client, (3,))
        if server is not None:
            fields["server"] = path_of(server, (3,))
        answer = self._change("Disconnect", fields, None, None, dry_run)
        if not dry_run and "id" in fields:
            self._place.forget(fields["id"])
        return answer

    def apply(self, system: Any, *, prune: bool = False, dry_run: bool = False) -> Answer:
        """Makes the system what a file (or a dict of its form) says, all or nothing; what does not differ goes on.

        ``prune`` takes away what the file's processes have and the file does not. Shows what it does as lines ``+ create …``,
        ``~ configure …``; with ``dry_run`` nothing is done. Processes are not started, and keep their folder: relative paths in
        configurations mean that of the file they were started with.
        """
        __tracebackhide__ = True
        name, text = _system_file.text_of(system, "apply")
        request = _proto.message("ApplyRequest")(system=text, prune=prune, validate_only=dry_run)
        try:
            answer = self._wire.call("GcmService/Apply", request, _WHOLE)
        except TrocarError as e:
            raise _system_file.placed(e, name) from None
        self._seen(0 if dry_run else answer.revision)
        return Answer("Apply", answer, dry_run)

    def diff(self, system: Any) -> list[str]:
        """Compares the system with a file (or a dict of its form): a line for each difference, ``+`` in the
        file alone, ``-`` in the system alone, ``~`` in both and not the same. Empty: there is none.
        """
        __tracebackhide__ = True
        name, text = _system_file.text_of(system, "diff")
        try:
            answer = self._wire.call("GcmService/Compare", _proto.message("CompareRequest")(system=text), _WHOLE)
        except TrocarError as e:
            raise _system_file.placed(e, name) from None
        self._tell(answer.notes)
        return [clean(line) for line in answer.differences]

    def save(self, file: str | os.PathLike[str] | None = None, *, replace: bool = False) -> str:
        """The system as the text of a system file, which ``apply``, ``trocar run`` and ``up`` take; written to ``file`` where one is
        given. A file that is there is replaced only with ``replace``.
        """
        __tracebackhide__ = True
        folder = os.path.abspath(os.path.dirname(os.fspath(file)) if file is not None else ".")
        answer = self._wire.call("GcmService/Save", _proto.message("SaveRequest")(folder=folder), _WHOLE)
        self._tell(answer.notes)
        text = str(answer.text)
        if file is not None:
            try:
                with open(file, "w" if replace else "x", encoding="utf-8") as out:
                    out.write(text)
            except FileExistsError:
                raise invalid(f"{os.fspath(file)} is there already: give another name, or replace=True", field="file") from None
            except OSError as e:
                raise invalid(f"{os.fspath(file)} cannot be written: {e.strerror}", field="file") from None
        return text

    def _tell(self, notes: Iterable[str]) -> None:
        for note in notes:
            self._say(f"note: {clean(note)}")

    def _seen(self, revision: int) -> None:
        """Waits a moment until this session's own copy of the graph shows what was just done."""
        self._graph.wait(lambda: self._graph.revision >= revision or not self._graph.connected, 0.5)

    def _each(self, verb: str, paths: tuple[Any, ...], dry_run: bool) -> Answer:
        __tracebackhide__ = True
        return self._change(verb, {"paths": named(verb, paths)}, None, None, dry_run)

    def _change(self, verb: str, fields: dict[str, Any], config: Any, execution: Any, dry_run: bool) -> Answer:
        __tracebackhide__ = True
        request = _proto.message(f"{verb}Request")(**fields, validate_only=dry_run)
        if config is not None:
            request.config.CopyFrom(_values.to_wire_struct(config, "config"))
        if execution is not None:
            request.execution.CopyFrom(_system_file.execution(execution, "execution"))
        if verb == "Stop":
            answer = self._wire.stop(request, _PATIENCE)
        else:
            answer = self._wire.call(f"GcmService/{verb}", request, _PATIENCE)
        self._seen(0 if dry_run else answer.revision)
        return Answer(verb, answer, dry_run)
