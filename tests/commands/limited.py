"""Commands in processes with limits of memory and time, so that a fault does no harm."""

import subprocess
import sys

CPU_S, HANGS_S, ADDRESS_SPACE = 20, 600.0, 3 << 30
"""Time of the processor, which other work on the machine does not change; wall time; bytes."""
MEMORY = 300 << 20
"""More than a command needs that reads a small file."""
LIMITED = f"""
import re, resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, ({ADDRESS_SPACE}, {ADDRESS_SPACE}))
resource.setrlimit(resource.RLIMIT_CPU, ({CPU_S}, {CPU_S}))
from bubbleviz.cli.command_line import main
try:
    main(sys.argv[2:])
finally:
    status = Path("/proc/self/status").read_text()
    Path(sys.argv[1]).write_text(re.search(r"VmHWM:\\s*(\\d+)", status)[1])
"""


def in_process(folder, *words):
    """A command in a process with limits of time and memory: how it ended, and its peak memory."""
    peak = folder / "peak_kb"
    command = [sys.executable, "-c", LIMITED, str(peak), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=False)
    return done, 1024 * int(peak.read_text())
