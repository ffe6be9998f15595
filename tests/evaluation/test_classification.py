"""Classification files: the format, and what is refused with which line."""

from __future__ import annotations

import pytest

from fsh3d_o3d.evaluation.classification import read_classification

GOOD = """PSB 1
5 6

aircraft 0 0

airplane aircraft 1
m12

F117 airplane 2
1298
1299

chair 0 1
7

-1 0 2
8 9
"""


def write(tmp_path, text):
    path = tmp_path / "some.cla"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_classes_models_and_parents(tmp_path, ends, mark):
    result = read_classification(write(tmp_path, mark + GOOD.replace("\n", ends).encode()))
    assert [group.name for group in result.classes] == ["aircraft", "airplane", "F117", "chair", "-1"]
    assert [group.full_name for group in result.classes][:3] == [
        "aircraft",
        "aircraft/airplane",
        "aircraft/airplane/F117",
    ]
    assert result.classes[2].parents == ("aircraft", "airplane")
    assert [group.miscellaneous for group in result.classes] == [False, False, False, False, True]
    assert result.models == ("m12", "1298", "1299", "7", "8", "9")
    assert result.labels == (1, 2, 2, 3, 4, 4)


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("", 1, "starts with 'PSB 1'"),
        ("PSB 2\n1 1\n", 1, "starts with 'PSB 1'"),
        ("OFF\n1 1\n", 1, "starts with 'PSB 1'"),
        ("PSB 1\nmany 6\n", 2, "the number of classes"),
        ("PSB 1\n1 -6\n", 2, "the number of models"),
        ("PSB 1\n1 2.0\n", 2, "the number of models"),
        (GOOD.replace("m12\n", ""), 8, "'airplane' appears a second time"),
        (GOOD.replace("airplane aircraft", "airplane boat"), 6, "the parent 'boat' of class 'airplane' is no class"),
        (GOOD.replace("F117 airplane", "airplane airplane"), 9, "'airplane' appears a second time"),
        (GOOD.replace("chair 0 1", "0 0 1"), 13, "'0' appears a second time"),
        (GOOD.replace("\n7\n", "\n1299\n"), 14, "model '1299' belongs to class 'F117' already"),
        (GOOD.replace("5 6", "5 7"), 17, "hold 6 models, but the second line announces 7"),
        (GOOD.replace("5 6", "4 4"), 16, "'-1' follows the last of 4 classes"),
        (GOOD.removesuffix("8 9\n"), 16, "ends where model 1 of 2 of class '-1'"),
        (GOOD.removesuffix(" 9\n"), 17, "ends where model 2 of 2 of class '-1'"),
        ("PSB 1\n999999999 1\na 0 1\n3\n", 4, "ends where class 2 of 999999999"),
        (b"PSB 1\n1 1\n\xff\xfe\n", 3, "not UTF-8"),
    ],
)
def test_malformed(tmp_path, text, line, reason):
    path = write(tmp_path, text)
    with pytest.raises(ValueError) as caught:
        read_classification(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: line {line}: "), message
    assert reason in message
    assert "\n" not in message


def test_every_truncation_is_refused(tmp_path):
    words = GOOD.split()
    for count in range(len(words)):
        with pytest.raises(ValueError, match="line 1: "):
            read_classification(write(tmp_path, " ".join(words[:count])))
    assert len(read_classification(write(tmp_path, " ".join(words))).models) == 6


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_classification(tmp_path / "none.cla")
    with pytest.raises(IsADirectoryError):
        read_classification(tmp_path)
