"""`palpate report`: a result folder in, its report out."""

from pathlib import Path

from palpate.app.terminal.output import print_text
from palpate.records import REPORT_FILE, check_fit_result, check_free, disk_errors
from palpate.report import write_report


def report(
    result: Path,
    /,
    *,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Write a result's report again, as one self-contained HTML file.

    `palpate fit` writes it along with its result, as report.html; this is for a copy elsewhere, or
    for a result whose report was removed.

    Parameters
    ----------
    result
        Result folder of `palpate fit`.
    out
        The file. Default: the result folder's name followed by -report.html, in the current folder.
    force
        Replace a file of that name.

    Returns
    -------
    int
        0.
    """
    check_fit_result(result)
    target = out or Path(f"{result.resolve().name}-{REPORT_FILE}")
    check_free(target, force=force)
    with disk_errors(target):
        write_report(result, target)
    print_text(f"Report in {target} ({target.stat().st_size / 1e6:.1f} MB)", wrapped=False)
    return 0
