"""The research shell of trocar: a running system from a Python prompt.

    import trocar
    ire = trocar.connect()
    r = ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))
    r.Write(30)
    r.Read()

``connect`` gives a ``Session``; ``read`` opens a recording; what is refused raises ``TrocarError``.
"""

from ._errors import TrocarError
from ._follow import Follower, Item
from ._mcap import RecordingFile, Topic, read
from ._proxy import Command, Event, Interface
from ._session import Session, connect
from ._values import Frame, Record, Rows

__version__ = "0.1.0"

__all__ = [
    "Command",
    "Event",
    "Follower",
    "Frame",
    "Interface",
    "Item",
    "Record",
    "RecordingFile",
    "Rows",
    "Session",
    "Topic",
    "TrocarError",
    "connect",
    "read",
]
