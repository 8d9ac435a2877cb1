"""The research shell of trocar: a running system from a Python prompt.

    import trocar
    ire = trocar.connect()
    r = ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))
    r.Write(30)
    r.Read()

``connect`` gives a ``Session``; ``Recording`` opens a recording; what is refused raises ``TrocarError``.
"""

import os as _os

# gRPC's handlers around fork() abort processes that somebody starts while calls are under way (seen with grpcio 1.80). Nobody needs them
# who goes on with exec(), as subprocess does; a session is no child's to go on with anyway.
_os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "false")

from ._errors import TrocarError
from ._follow import Follower, Item
from ._notes import RecordingNote
from ._proxy import Command, Event, Interface
from ._recording import Recording, read
from ._session import Session, connect, stop
from ._topic import Topic
from ._values import Frame, Record, Rows

__version__ = "0.1.0"

RecordingFile = Recording

__all__ = [
    "Command",
    "Event",
    "Follower",
    "Frame",
    "Interface",
    "Item",
    "Record",
    "Recording",
    "RecordingFile",
    "RecordingNote",
    "Rows",
    "Session",
    "Topic",
    "TrocarError",
    "connect",
    "read",
    "stop",
]
