"""interior."""

from palpate.bem.interior.interior import (
    InteriorState as InteriorState,
    interior_state as interior_state,
)
