"""Pages run in forked kernels as they do in ordinary ones."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere kernels are not forked")
SCRIPTS = Path(__file__).parents[1] / "scripts"
CELL = """
import sys, multiprocessing, os, matplotlib.pyplot as plt
plt.plot([1, 2])
print(os.getcwd(), sys.path, multiprocessing.get_start_method())
print(os.environ.get("TOLD"), os.environ["MPLBACKEND"])
"""
RUN = """
import sys
sys.path.insert(0, {scripts!r})
import nbformat
from nbclient import NotebookClient
import forked_kernels

if __name__ == "__main__":
    {use}
    for cells in {runs!r}:
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
        client = NotebookClient(notebook, timeout=100, resources={{"metadata": {{"path": {folder!r}}}}})
        try:
            client.execute()
        except Exception as error:
            print(type(error).__name__)
        for output in notebook.cells[0].outputs:
            print(output.output_type, output.get("text"), sorted(output.get("data", ())))
    assert forked_kernels.cpu_of_kernels() > 0
"""
USE = "forked_kernels.use_forked_kernels()"


def command(folder: Path, use: str, *runs: list[str]) -> list[str]:
    program = folder / "program.py"
    program.write_text(RUN.format(scripts=str(SCRIPTS), use=use, runs=runs, folder=str(folder)))
    return [sys.executable, str(program)]


def test_a_forked_kernel_shows_what_an_ordinary_one_shows(tmp_path):
    environment = os.environ | {"TOLD": "yes", "IPYTHONDIR": str(tmp_path)}
    runs = [CELL], ["1 / 0"], ["import os; os._exit(3)"]
    shown = [
        subprocess.run(command(tmp_path, use, *runs), capture_output=True, text=True, env=environment).stdout
        for use in (USE, "pass")
    ]
    assert shown[0] == shown[1]
    for part in ("image/png", "CellExecutionError", "DeadKernelError"):
        assert part in shown[0]


def test_a_kernel_ends_with_the_process_that_started_it(tmp_path):
    told = tmp_path / "pid"
    cell = f"import os, time; open({str(told)!r}, 'w').write(str(os.getpid())); time.sleep(100)"
    process = subprocess.Popen(command(tmp_path, USE, [cell]), env=os.environ | {"IPYTHONDIR": str(tmp_path)})
    while not (told.exists() and told.read_text()):
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kernel = int(told.read_text())
    deadline = time.monotonic() + 20
    while Path(f"/proc/{kernel}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.1)
