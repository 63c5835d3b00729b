"""responses."""

from palpate.estimation.responses.reduced_model import (
    ReducedModel as ReducedModel,
    make_reduced_model as make_reduced_model,
)
from palpate.estimation.responses.responses import (
    FullModel as FullModel,
    FullResponse as FullResponse,
    PointRows as PointRows,
    ProbeRows as ProbeRows,
    ReducedResponse as ReducedResponse,
    reduced_response as reduced_response,
)
from palpate.estimation.responses.table import (
    GramTable as GramTable,
    NodeProducts as NodeProducts,
    ResponseTable as ResponseTable,
    node_products as node_products,
    response_table as response_table,
)
