"""What schemathesis is not to send: see `described.py`."""

import schemathesis


@schemathesis.hook
def filter_query(context, query):
    """An empty parameter (a list or an object without content is sent as one) counts as one that is not set, which no schema can state: forms and scripts send those."""
    return not any(value in ("", [], {}) for value in (query or {}).values())
