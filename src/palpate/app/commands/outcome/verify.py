"""`palpate verify`: whether a result is as it was written, and its inputs as they were."""

import sys
from collections import Counter
from pathlib import Path

from palpate.app.exit_codes import NOT_OK
from palpate.app.terminal import print_tables, print_text, terminal_table
from palpate.records import verify_result


def verify(result: Path, /) -> int:
    """Compare a result with the sums that it carries of itself and of what it was made from.

    Parameters
    ----------
    result
        A result folder, or the JSON file that `palpate compression` wrote.

    Returns
    -------
    int
        0, or 3 where something has changed since or contradicts itself.
    """
    found = verify_result(result)
    wrong = [finding for finding in found if not finding.is_unchanged]
    if wrong:
        rows = [(finding.file, finding.role, finding.state) for finding in wrong]
        print_tables(terminal_table(f"Changed in {result}", ("file", "role", "state"), rows))
        shown = ", ".join(f"{finding.file} ({finding.state})" for finding in wrong[:3])
        more = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        print(f"palpate: {result}: not as it was: {shown}{more}", file=sys.stderr)
        return NOT_OK
    count = Counter(finding.role for finding in found)
    inputs = f"the {count['input']} files that it was made from"
    parts = f"; beside it {count['part']} finished parts of an interrupted run, as they were kept"
    print_text(
        f"{result}: its {count['result']} files are as they were written, {inputs} as they were"
        f" read{parts if count['part'] else ''}"
    )
    return 0
