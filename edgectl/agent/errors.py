"""What the agent says when it will not do what was asked."""


class RefusalError(Exception):
    """Declined, with a stable ``kind``, a one-line message and a hint that mends it."""

    def __init__(self, kind: str, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.kind = kind
        self.message = message
        self.hint = hint
