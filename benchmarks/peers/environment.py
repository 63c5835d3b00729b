"""Makes other programs' environments and runs commands in them."""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Environment:
    """A virtual environment beside the requirements that it is made from.

    Parameters
    ----------
    folder : Path             holds requirements.txt; .venv is made in it
    programs : str            what is installed, for messages
    """

    folder: Path
    programs: str

    @property
    def python(self) -> Path:
        """Its interpreter."""
        return self.folder / ".venv" / "bin" / "python"

    @property
    def _stamp(self) -> Path:
        """Says that everything was installed, not only begun."""
        return self.folder / ".venv" / "run.stamp"

    def problem(self, *, make: bool, all_needed: bool = True) -> str:
        """Make the environment where it is missing; empty, or why it cannot be used.

        Parameters
        ----------
        make : bool           whether a missing environment may be made
        all_needed : bool     False: a package that cannot be installed is left out
        """
        if self._stamp.exists():
            return ""
        if not make:
            return f"not measured: run with --peers to make the environment of {self.programs}"
        done = run_command([sys.executable, "-m", "venv", str(self.python.parent.parent)])
        if done.returncode == 0:
            done = self._installed(all_needed)
        if done.returncode == 0:
            self._stamp.touch()
            return ""
        return f"{self.programs} could not be installed: {last_line(done.stderr)}"

    def _installed(self, all_needed: bool) -> subprocess.CompletedProcess[str]:
        """What the installer says of everything together, or of the last package that it took."""
        listed = self.folder / "requirements.txt"
        install = [str(self.python), "-m", "pip", "install", "--quiet"]
        done = run_command([*install, "-r", str(listed)])
        if done.returncode == 0 or all_needed:
            return done
        one_by_one = [
            run_command([*install, "-c", str(listed), package])
            for package in listed.read_text(encoding="utf-8").split()
        ]
        return next((attempt for attempt in one_by_one if attempt.returncode == 0), done)


def run_command(
    command: Sequence[str], *, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end and keep what it prints."""
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


def last_line(text: str) -> str:
    """What a program said last."""
    return (text.strip().splitlines() or ["no message"])[-1]
