"""Other programs, in environments of their own.

Purpose    : times and errors of other programs on the same input, from the same run.
Takes      : a mesh, the bench of speckle pairs, or a stereo series; the package index, where an
             environment is to be made.
Gives      : their figures, or the reason why there are none.
Depends on : `geometry`; a `requirements.txt` for each environment pins what is installed.
Read first : `environment.py`, then `laplace_peer.py`, `speckle_peer.py`, `stereo_peer.py`.
"""

from benchmarks.peers.laplace_peer import laplace_times as laplace_times
from benchmarks.peers.speckle_peer import speckle_rows as speckle_rows
from benchmarks.peers.stereo_peer import StereoField as StereoField, stereo_field as stereo_field
