"""What can go wrong for a user: one error and a handful of children, each with a way out."""


class IsacTrackError(Exception):
    """A user's mistake or a missing resource; the message names it and the way out."""


class DataError(IsacTrackError):
    """A data set that cannot be read; the message names file and line."""


class SettingsError(IsacTrackError):
    """An option, a setting or a SPEC that is wrong, unknown or contradicts another."""


class PluginError(IsacTrackError):
    """A plug-in that cannot be loaded, or that breaks its contract."""


class KnowledgeDenied(IsacTrackError):  # noqa: N818 - the contract's name
    """An attack touched what its adversary was not granted, or what it did not declare."""
