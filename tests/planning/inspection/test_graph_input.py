"""Edge lists."""

import pytest

from bundle import InputError
from bundle.planning.inspection.graph_inspection import load_graph


@pytest.fixture
def load(tmp_path):
    def write_and_load(text):
        path = tmp_path / "graph.txt"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_graph(path)

    return write_and_load


def test_names_comments_and_lone_variables(load):
    graph = load("# a graph\nx0 x1\n\nx1, l1 % seen\r\nlonely\nx1\tx0\nx0 l1#again\n")
    assert graph.names == ("x0", "x1", "l1", "lonely")
    assert graph.edges == ((0, 1), (1, 2), (1, 0), (0, 2))
    assert graph.landmarks == (2,)


def test_integers_come_in_their_order(load):
    graph = load("10 9\n-1 10\n2\n")
    assert graph.names == ("-1", "2", "9", "10")
    assert graph.edges == ((3, 2), (0, 3))


def test_nothing(load):
    assert load("").names == ()
    assert load("\ufeff# only words\n").names == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a b\na b c\n", "2: expected one or two variables, found 3: a b c"),
        ("a b\n\nb b\n", "3: expected two different variables, found b twice"),
        (b"a b\n\xe9 b\n", "2: expected UTF-8 text, found byte 0xe9"),
        ("a\x1bb a\x1bb", r"1: expected two different variables, found a\x1bb twice"),
    ],
)
def test_errors_name_file_and_line(load, tmp_path, text, message):
    with pytest.raises(InputError) as refused:
        load(text)
    assert str(refused.value) == f"{tmp_path / 'graph.txt'}:{message}"


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_graph(tmp_path / "none.txt")
