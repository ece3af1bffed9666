"""SPECs: the plug-ins that they name, the messages of mistakes, and third parties."""

import re
import sys
from dataclasses import dataclass

import pytest

from isac_track import errors, plugins
from isac_track.errors import PluginError, SettingsError
from isac_track.mechanisms.controls import Correlated, Offset, Thin
from isac_track.sharing import Fid, Fixed, Raw
from predictors.least_squares import LeastSquares


class Shares:
    def share(self, sensed, rng): ...


@dataclass(frozen=True)
class Odd(Shares):
    """Parameters of every kind that a SPEC can give."""

    word: str = "soft"
    count: int = 3
    loud: bool = False
    limit: float | None = None


@dataclass(frozen=True)
class Heir(Fixed):
    """Inherited parameters whose types this module does not import."""

    extra: float = 1.0


@dataclass(frozen=True)
class Unknown(Shares):
    width: "Somewhere" = 1  # noqa: F821 - that no name is m is the point - as under TYPE_CHECKING


@dataclass(frozen=True)
class Unread(Shares):
    width: "float | 'm'" = 1  # noqa: F821 - that no name is m is the point


@dataclass(frozen=True)
class Picky(Shares):
    """Raises an error of this kind in its own initialisation."""

    kind: str

    def __post_init__(self):
        raise {
            "key": KeyError("width"),
            "type": TypeError("no text, please"),
            "value": ValueError("half a pair \udcff,\nand more"),
            "exit": SystemExit(0),
            "settings": SettingsError("ask for less"),
        }[self.kind]


@dataclass
class Thawed(Shares):
    pass


@dataclass(frozen=True)
class Mute:
    pass


@dataclass(frozen=True)
class NoRequires:
    def predict(self, release, t_future): ...


@dataclass(frozen=True)
class Secretive(NoRequires):
    @property
    def requires(self):
        raise KeyError("a secret")


class UnsayableError(Exception):
    def __str__(self):
        raise RuntimeError


@pytest.fixture
def here(monkeypatch):
    """The name under which this module can be imported."""
    monkeypatch.setitem(sys.modules, "my.module", sys.modules[__name__])
    return "my.module"


def parse_single(kind, spec):
    (plugin,) = plugins.parse(kind, spec)
    return plugin


@pytest.mark.parametrize(
    ("kind", "spec", "name", "level", "instance"),
    [
        ("mechanisms", "raw", "raw", None, Raw()),
        ("mechanisms", "fid:7,beta=2.0", "fid:beta=2", 7.0, Fid(7.0, beta=2.0)),
        ("mechanisms", "correlated:0.75", "correlated", 0.75, Correlated(0.75)),
        (
            "mechanisms",
            "correlated:1,tau_s=5",
            "correlated:tau_s=5",
            1.0,
            Correlated(1.0, 5.0),
        ),
        ("mechanisms", "offset:0.4", "offset", 0.4, Offset(0.4)),
        (
            "mechanisms",
            "thin:4,d_sigma=0.75",
            "thin:d_sigma=0.75",
            4.0,
            Thin(4, d_sigma=0.75),
        ),
        ("predictors", "least_squares", "least_squares", None, LeastSquares()),
        (
            "predictors",
            "least_squares:8",
            "least_squares:window=8",
            None,
            LeastSquares(8),
        ),
    ],
)
def test_the_level_of_a_mechanism_leaves_the_name_others_stay(
    kind, spec, name, level, instance
):
    plugin = parse_single(kind, spec)
    assert (plugin.name, plugin.level, plugin.instance) == (name, level, instance)
    assert parse_single(kind, plugin.spec) == plugin


def test_spellings_of_one_thing_are_one_thing():
    hundred = (
        "fid:100",
        "fid:1e2",
        "fid:eta=100",
        "fid:100.0,alpha=0.5",
        "fid:100.00000000000004",
    )
    thinned = (
        "thin:4,d_sigma=0.75,adding=independent",
        "thin:4,adding=independent,d_sigma=0.75",
    )
    for specs in (hundred, thinned):
        (plugin,) = plugins.parse_all("mechanisms", specs)
        assert parse_single("mechanisms", plugin.spec) == plugin
    parsed = plugins.parse_all("mechanisms", ("fid:1", "fid:1..100/3", "raw", "raw"))
    assert [plugin.spec for plugin in parsed] == ["fid:1", "fid:10", "fid:100", "raw"]


@pytest.mark.parametrize(
    ("spec", "levels"),
    [
        ("fid:1..1000/4", [1.0, 10.0, 100.0, 1000.0]),
        ("fixed:0.1..1/10", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]),
        ("thin:1..8/8", [1, 2, 3, 4, 5, 6, 7, 8]),
        ("fid:100..1/3", [100.0, 10.0, 1.0]),
    ],
)
def test_a_logarithmic_and_a_linear_sweep(spec, levels):
    assert [plugin.level for plugin in plugins.parse("mechanisms", spec)] == levels


def test_a_class_by_its_path(here):
    plugin = parse_single("mechanisms", f"{here}:Odd:hard,count=5,loud=true,limit=2.5")
    assert plugin.instance == Odd(word="hard", count=5, loud=True, limit=2.5)
    assert plugin.level is None
    assert plugin.name == f"{here}:Odd:word=hard,count=5,loud=true,limit=2.5"
    assert parse_single("mechanisms", f"{here}:Odd:limit=none").instance == Odd()
    assert parse_single("mechanisms", plugin.spec).instance == plugin.instance


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("fdi:1", "unknown mechanism 'fdi'; did you mean 'fid'?"),
        (
            "zzzzz",
            "unknown mechanism 'zzzzz'; known: clean, correlated, fid, fixed, forecast",
        ),
        ("fixed", "fixed needs a value for d_sigma, as in fixed:VALUE"),
        ("raw:3", "raw takes no value"),
        ("fid:1,alhpa=3", "fid has no parameter 'alhpa'; did you mean 'alpha'?"),
        ("fid:1,eta=2", "eta is given twice"),
        ("fid:one", "eta must be a number, got 'one'"),
        ("fid:nan", "eta must be finite"),
        ("fid:1,adding=up", "adding must be one of linear, independent, got 'up'"),
        ("fid:1,2", "'2' is not key=value"),
        ("", "a SPEC begins with a name"),
        ("fid:1..10", "a sweep is LOW..HIGH/COUNT"),
        ("fid:1..10/1", "COUNT >= 2"),
        ("fid:5..5/3", "two finite ends that differ"),
        ("fid:0..10/3", "logarithmic; both ends must be positive"),
        ("os.path", "expected package.module:Class"),
        ("thin:1000000000000", "every must have at most 12 digits, got '1000"),
        ("thin:" + "9" * 5000, "every must be a whole number, got '999"),
        ("q" * 5000, "unknown mechanism 'qqq"),
        ("fid:1," + "z" * 5000, "zzz... is not key=value"),
        ("correlated:-1", "'correlated:-1': d_sigma must be 0 m or more, got -1.0"),
        (
            "correlated:1,tau_s=0",
            "'correlated:1,tau_s=0': tau_s must be positive, got 0.0",
        ),
        ("offset:-0.1", "'offset:-0.1': distance must be 0 m or more, got -0.1"),
        ("thin:0", "'thin:0': every must be 1 or more, got 0"),
        ("thin:2,d_sigma=-1", "d_sigma must be 0 m or more, got -1.0"),
    ],
)
def test_a_wrong_spec_says_what_is_wrong_and_repeats_it_in_short(spec, message):
    with pytest.raises(SettingsError, match=re.escape(message)) as caught:
        plugins.parse("mechanisms", spec)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("kind", "error", "message"),
    [
        (
            "key",
            PluginError,
            "my.module:Picky cannot be made: KeyError: 'width'; a plug-in",
        ),
        (
            "type",
            PluginError,
            "my.module:Picky cannot be made: TypeError: no text, please; a",
        ),
        (
            "exit",
            PluginError,
            "my.module:Picky cannot be made: SystemExit: 0; a plug-in",
        ),
        (
            "value",
            SettingsError,
            r"'my.module:Picky:value': half a pair \udcff, and more",
        ),
        ("settings", SettingsError, "'my.module:Picky:settings': ask for less"),
    ],
)
def test_a_plugin_that_cannot_be_made_says_why(here, kind, error, message):
    with pytest.raises(error, match=re.escape(message)):
        plugins.parse("mechanisms", f"{here}:Picky:{kind}")
    with pytest.raises(
        SettingsError, match=r"Picky needs a value for kind, as in .*Picky:VALUE"
    ):
        plugins.parse("mechanisms", f"{here}:Picky")


def test_inherited_parameters_are_read_where_they_are_declared(here):
    plugin = parse_single(
        "mechanisms", f"{here}:Heir:0.5,adding=independent,law=isotropic,extra=3"
    )
    assert plugin.instance == Heir(
        0.5, adding="independent", law="isotropic", extra=3.0
    )
    assert parse_single("mechanisms", plugin.spec) == plugin


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (KeyError("x"), "KeyError: 'x'"),
        (KeyboardInterrupt(), "KeyboardInterrupt"),
        (UnsayableError(), "UnsayableError: (its message cannot be read)"),
        (ValueError("one\ntwo\r\n\tthree\u2028four"), "ValueError: one two three four"),
        (ValueError("\x1b[31m\udcff\u202e\0"), r"ValueError: \x1b[31m\udcff\u202e\x00"),
        (
            ValueError("Zürich \N{GRINNING FACE}"),
            "ValueError: Zürich \N{GRINNING FACE}",
        ),
        (ValueError("a" * 1_000_000), "ValueError: " + "a" * 288 + "..."),
    ],
)
def test_a_foreign_error_is_reported_on_one_line(error, message):
    assert errors.error_text(error) == message


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        (
            "mechanisms",
            "no.such.module:Thing",
            "cannot be loaded from no.such.module:Thing",
        ),
        (
            "mechanisms",
            "no.such.module:Thing",
            "run it in the folder that holds it, or install the package",
        ),
        ("mechanisms", "os.path:join", "must be a frozen dataclass"),
        (
            "mechanisms",
            "my.module:Thawed",
            "my.module:Thawed must be a frozen dataclass",
        ),
        ("mechanisms", "my.module:Mute", "has no method share()"),
        ("predictors", "my.module:NoRequires", "requires must be a frozenset"),
        (
            "predictors",
            "my.module:Secretive",
            "Secretive.requires: KeyError: 'a secret'",
        ),
        ("mechanisms", "my.module:Unknown", "must be imported at run time"),
        ("mechanisms", "my.module:Unread", "my.module:Unread: the type of width: "),
    ],
)
@pytest.mark.usefixtures("here")
def test_a_broken_plugin_is_named(kind, name, message):
    with pytest.raises(PluginError, match=re.escape(message)):
        plugins.parse(kind, name)


def test_a_module_of_another_folder_is_named():
    message = "no module 'nowhere'; run it in the folder that holds it"
    with pytest.raises(SettingsError, match=message):
        plugins.parse("mechanisms", "nowhere:Mine:0.3")
    with pytest.raises(SettingsError, match="unknown mechanism 'nowhere'"):
        plugins.parse("mechanisms", "nowhere:0.3")


def test_an_installed_third_party_plugin_is_known_by_name(tmp_path, monkeypatch):
    """A package with real entry points, one of them broken, in a folder of its own."""
    info = tmp_path / "blur-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: blur\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[isac_track.mechanisms]\nblur = isac_track.sharing:Fixed\ntorn ="
        " os.path:Nothing\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    plugins._entry_points.cache_clear()
    try:
        assert parse_single("mechanisms", "blur:0.2").instance == Fixed(0.2)
        wrong = plugins.broken("mechanisms")
    finally:
        plugins._entry_points.cache_clear()
    assert wrong.keys() == {"torn"}
    assert "Nothing" in wrong["torn"]


MECHANISM = """
from dataclasses import dataclass
from isac_track.sharing import perturb

@dataclass(frozen=True)
class MyNoise:
    d_sigma: float = 1.0

    def share(self, sensed, rng):
        return perturb(sensed, self.d_sigma, rng)
"""


@pytest.mark.parametrize(
    ("file", "spec", "origin"),
    [
        ("my_noise.py", "./my_noise.py:0.5", "my_noise:MyNoise"),
        ("my_noise/my_noise.py", "./my_noise:0.5", "my_noise.my_noise:MyNoise"),
        ("my_noise/my_noise.py", "my_noise:0.5", "my_noise.my_noise:MyNoise"),
        (
            "some/my_noise/my_noise.py",
            "./some/my_noise:0.5",
            "some.my_noise.my_noise:MyNoise",
        ),
        ("my_noise.py", ".\\my_noise.py:0.5", "my_noise:MyNoise"),
        ("my_noise.py", "./my_noise.py:MyNoise:0.5", "my_noise:MyNoise"),
        ("some/my_noise.py", "some\\my_noise.py:MyNoise:0.5", "some.my_noise:MyNoise"),
        ("my_noise.py", "{}/my_noise.py:0.5", "my_noise:MyNoise"),
        ("my_noise.py", "{}/my_noise.py:MyNoise:0.5", "my_noise:MyNoise"),
    ],
)
def test_a_path_names_a_file_of_the_user(tmp_path, monkeypatch, file, spec, origin):
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(MECHANISM, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    (plugin,) = plugins.parse("mechanisms", spec.format(tmp_path))
    assert (plugin.origin, plugin.level) == (origin, 0.5)
    for name in [
        name for name in sys.modules if name.partition(".")[0] in ("my_noise", "some")
    ]:
        del sys.modules[name]


@pytest.mark.parametrize(
    "spec", ["./", "./my-noise", "./../elsewhere", "./my_noise.py.py"]
)
def test_a_path_that_python_cannot_import_is_refused(spec):
    with pytest.raises(SettingsError, match="followed by a Python file"):
        plugins.parse("mechanisms", spec)


@pytest.mark.parametrize(
    ("path", "parts"),
    [
        (r"C:\work\x", ("x",)),
        (r"c:\Work\some\x", ("some", "x")),
        (r"C:\\work\\x", ("x",)),
        ("C:/work/x", ("x",)),
        (r".\x", ("x",)),
        (r"D:\work\x", None),
        (r"C:\elsewhere\x", None),
        ("C:x", None),
        (r"\\server\share\x", None),
    ],
)
def test_a_windows_path_is_seen_from_the_folder_of_a_run(path, parts):
    assert plugins.parts_below(path, folder=r"C:\work") == parts


@pytest.mark.parametrize(
    ("spec", "way"),
    [
        (r"C:\x.py", "./x.py"),
        (r"C:\x.py:Class", "./x.py:Class"),
        (r"C:\\some\\x.py:Class:0.5", "./x.py:Class:0.5"),
        ("c:/x.py:Class", "./x.py:Class"),
        ("C:x.py:Class", "./x.py:Class"),
        (r"\\server\share\x.py:Class", "./x.py:Class"),
        ("/nowhere/x.py:Class", "./x.py:Class"),
    ],
)
@pytest.mark.parametrize("kind", ["mechanisms", "predictors", "attacks"])
def test_a_path_that_is_not_below_is_a_path_still(kind, spec, way):
    with pytest.raises(
        SettingsError, match="named from the folder that a run starts in"
    ) as caught:
        plugins.parse(kind, spec)
    assert str(caught.value).endswith(f"write '{way}'")
    assert len(str(caught.value).splitlines()) == 1


def test_a_switch_is_named_as_in_its_spec():
    (aware,) = plugins.parse("predictors", "kalman_cv:aware=true")
    assert aware.instance.aware is True
    assert aware.name == aware.spec == "kalman_cv:aware=true"
