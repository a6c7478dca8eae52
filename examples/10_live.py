"""Pose a mesh live: driving frames come through a socket, and each one poses the identity.

python examples/10_live.py                                       # sender and receiver, with shipped inputs
python examples/10_live.py --role receive hero.glb recorded.npz  # yours: waits for frames of recorded.npz's mesh
python examples/10_live.py --role send recorded.npz              # in another terminal: plays the clip
"""

import argparse
import itertools
import socket
import struct
import threading
import time
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

import mimesh
from mimesh.bodies import load_body
from mimesh.bodies.characters import character
from mimesh.tools.demo import driving_clip

RATE = 60.0
MOST = 2**22  # vertices of a frame; more than that is no frame but another protocol


def send(clip: mimesh.Clip, port: int, seconds: float) -> None:
    """Send frames as a capture system would: the number of vertices (uint32), then x, y, z of each (float32)."""
    with socket.create_connection(("127.0.0.1", port)) as stream:
        start = time.monotonic()
        for due in itertools.takewhile(lambda due: due < seconds, (k / RATE for k in itertools.count())):
            time.sleep(max(0.0, start + due - time.monotonic()))
            vertices = clip.vertices[int(due * clip.fps) % len(clip)]
            stream.sendall(struct.pack("<I", len(vertices)) + vertices.astype("<f4").tobytes())


def read_frame(stream: BinaryIO) -> NDArray[np.float32] | None:
    """Read one frame; None at the end of the stream."""
    header = stream.read(4)
    if len(header) < 4:
        return None
    (count,) = struct.unpack("<I", header)
    if count > MOST:
        raise SystemExit(f"expected frames of at most {MOST} vertices, found {count}")
    content = stream.read(12 * count)
    return np.frombuffer(content, "<f4").reshape(-1, 3) if len(content) == 12 * count else None


def receive(identity: mimesh.Mesh, clip: mimesh.Clip, listening: socket.socket, output: Path) -> None:
    """Pose the identity by every frame of a connection, and save the last one."""
    # The recorded clip has the mesh of the stream. Its first frame is enough; with more, joints are found more exactly.
    session = mimesh.prepare(identity, clip)
    for note in session.notes:
        print("note:", note)
    times: list[float] = []
    result = identity.vertices
    connection, _ = listening.accept()
    with connection, connection.makefile("rb") as stream:
        while (frame := read_frame(stream)) is not None:
            start = time.perf_counter()
            try:
                result = session.pose(frame)  # (V, 3): give it to your engine or viewer here
            except mimesh.InputError as error:
                print("left out:", error)
                continue
            times.append(1e3 * (time.perf_counter() - start))
    if times:
        print(f"{len(times)} frames, {np.median(times):.1f} ms each, the slowest {max(times):.1f} ms")
    mimesh.save_mesh(identity.with_vertices(result), output / "last.glb")
    print("wrote", output / "last.glb")


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="identity (not to send) and recorded driving clip")
    parser.add_argument("--role", choices=("both", "send", "receive"), default="both")
    parser.add_argument("--port", type=int, default=9001, help="port of this machine for driving frames; 0: any")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to send")
    parser.add_argument("-o", "--output", type=Path, default=Path("10_live"), help="folder")
    options = parser.parse_args(argv)
    clip = mimesh.load_clip(options.files[-1]) if options.files else driving_clip(load_body())
    if options.role == "send":
        send(clip, options.port, options.seconds)
        return
    identity = mimesh.load_mesh(options.files[0]) if options.files else character("runner")
    with socket.create_server(("127.0.0.1", options.port)) as listening:  # this machine only
        if options.role == "both":
            port = listening.getsockname()[1]
            threading.Thread(target=send, args=(clip, port, options.seconds), daemon=True).start()
        receive(identity, clip, listening, options.output)


if __name__ == "__main__":
    main()
