#!/usr/bin/env python3
"""What a call from Python costs: ``r.Write(30)`` beside a bare grpcio unary call of the same request, in one run, turn by turn.

    python3 sdk/python/tests/run.py --bench [--calls 1000]

Starts the built program (TROCAR_BIN_DIR). Prints a table; exit 1 when the median of ``r.Write(30)`` is above 1 ms.
"""

import argparse
import pathlib
import sys
import tempfile
import time

import grpc
import numpy as np

import trocar
from trocar import _proto, _values

LIMIT_US = 1000


def timed(calls, *functions):
    """Times of each function, µs: in turns of 50, so that what else runs meets all of them alike."""
    out = [[] for _ in functions]
    for _ in range(max(1, calls // 50)):
        for times, function in zip(out, functions):
            for _ in range(50):
                begun = time.perf_counter()
                function()
                times.append((time.perf_counter() - begun) * 1e6)
    return [np.array(t) for t in out]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=1000)
    calls = parser.parse_args().calls
    sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
    from tests.outer.conftest import Program, linked

    with tempfile.TemporaryDirectory() as directory:
        directory = pathlib.Path(directory)
        plugins, missing = linked(directory, "example")
        if missing:
            print("the example plugin was not built: run ./tests/run")
            return 1
        program = Program(directory, "host", "host", "--name", "ProcessServer", "--plugins", plugins, "--listen", "127.0.0.1:0",
                          "--state", directory / "host-state")  # fmt: skip
        try:
            return measure(program.address(r"(127\.0\.0\.1:\d+)"), calls)
        finally:
            program.end()


def measure(address, calls):
    from tests.conftest import eventually

    with trocar.connect(address) as ire:
        eventually("the class is there", lambda: "example/Server" in ire.classes())
        ire.create("ProcessServer/Server", "Server")
        ire.start("ProcessServer/Server")
        r = ire.AddInterfaceRequiredAndConnect(("ProcessServer", "Server", "Provided"))
        method = _proto.METHODS["InteractService/Invoke"]
        request = method.request(path="ProcessServer/Server/Provided/Write", json=_values.to_wire(30)).SerializeToString()
        with grpc.insecure_channel(address) as channel:
            bare = channel.unary_unary(method.path)
            timed(100, lambda: r.Write(30), lambda: bare(request, timeout=2))
            write, read, direct = timed(calls, lambda: r.Write(30), lambda: r.Read(), lambda: bare(request, timeout=2))
    print(f"{'call':<34} {'p50':>8} {'p99':>8} {'ratio':>6}   ({len(write)} calls each, turn by turn)")
    for name, times in (("r.Write(30)", write), ("r.Read()", read), ("bare grpcio unary, same request", direct)):
        p50, p99 = np.percentile(times, [50, 99])
        print(f"{name:<34} {p50:>5.0f} µs {p99:>5.0f} µs {p50 / np.median(direct):>6.2f}")
    median = float(np.median(write))
    held = median <= LIMIT_US
    print(f"r.Write(30): p50 {median:.0f} µs, {'at most' if held else 'ABOVE'} {LIMIT_US} µs")
    print(f"test bench::a_call_takes_at_most_a_millisecond ... {'ok' if held else 'FAILED'}")
    print(f"test result: {'ok' if held else 'FAILED'}. {int(held)} passed; {int(not held)} failed; 0 ignored")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
