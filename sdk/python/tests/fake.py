"""A host that answers what a test says: for faults that a real one has to be broken for."""

import concurrent.futures
import threading
import time

import grpc

from trocar import _errors, _proto


def message(name, /, **fields):
    return _proto.message(name)(**fields)


class Refused(Exception):
    def __init__(self, code, text="", details=None):
        self.code, self.text, self.details = code, text, details


def packed(code, text, reason, **metadata):
    """A refusal as the host packs it."""
    info = _errors._DETAILS["google.rpc.ErrorInfo"](reason=reason, domain="trocar.v1", metadata=metadata)
    status = _proto.message("trocar.status.Status")(code=code.value[0], message=text)
    status.details.add(type_url="type.googleapis.com/google.rpc.ErrorInfo", value=info.SerializeToString())
    return Refused(code, text, status.SerializeToString())


def server_interface():
    """The example's interface, as Describe has it."""
    i32 = message("TypeInfo", name="i32", size=4, primitive=7)
    argument = message("Argument", name="value", doc="New set point", type=i32, unit="mm", min=0, max=100)
    return message(
        "ProvidedInterface",
        name="Provided",
        commands=[
            message("Command", name="Write", doc="Sets the set point.", kind=2, arg=argument),
            message("Command", name="Read", doc="The set point.", kind=3, ret=i32, ret_unit="mm"),
        ],
        events=[message("Event", name="SetPointReached", payload=i32, unit="mm")],
    )


class Fake:
    """``answers`` maps ``Service/Method`` to a function of (request, context)."""

    def __init__(self, credentials=None, port=0, door=None):
        self.answers = {
            "GcmService/Watch": self.watch,
            "GuestService/Join": self.join,
            "GuestService/Require": lambda r, c: message(
                "RequireResponse", client=f"{r.component}/Provided", connection=1, provided=server_interface()
            ),
            "GcmService/Describe": lambda r, c: message(
                "DescribeResponse", ports=message("Ports", provided=[server_interface()]), component=message("Component", path=r.path)
            ),
        }
        self.asked = []
        self.ending = threading.Event()
        self.server = grpc.server(concurrent.futures.ThreadPoolExecutor(32))
        self.server.add_generic_rpc_handlers([self])
        if credentials is None:
            self.port = self.server.add_insecure_port(f"127.0.0.1:{port}")
        else:
            self.port = self.server.add_secure_port(f"127.0.0.1:{port}", credentials)
        if door is not None:
            self.server.add_insecure_port(f"unix:{door}")
        self.address = f"127.0.0.1:{self.port}"
        self.server.start()

    def watch(self, request, context):
        component = _proto.message("Component")(path="ProcessServer/Server", state=3)
        snapshot = message("Snapshot", processes=[message("Process", name="ProcessServer", state=1)], components=[component])
        yield message("WatchResponse", revision=1, term=7, snapshot=snapshot)
        self.stay(context)

    def join(self, request, context):
        self.asked.append(("join", request.process))
        yield message("JoinResponse", process=request.process, component=f"{request.process}/shell", epoch=1, term=7)
        self.stay(context)

    def stay(self, context):
        while context.is_active() and not self.ending.is_set():
            time.sleep(0.01)

    def service(self, details):
        name = details.method.removeprefix("/trocar.v1.")
        if name not in self.answers:
            return None
        method = _proto.METHODS[name]

        def refuse(context, e):
            if e.details is not None:
                context.set_trailing_metadata((("grpc-status-details-bin", e.details),))
            context.abort(e.code, e.text)

        def unary(request, context):
            try:
                return self.answers[name](request, context)
            except Refused as e:
                refuse(context, e)

        def stream(request, context):
            try:
                yield from self.answers[name](request, context)
            except Refused as e:
                refuse(context, e)

        make = grpc.unary_stream_rpc_method_handler if method.streams else grpc.unary_unary_rpc_method_handler
        return make(
            stream if method.streams else unary,
            request_deserializer=method.request.FromString,
            response_serializer=method.response.SerializeToString,
        )

    def end(self):
        self.ending.set()
        self.server.stop(0).wait()
