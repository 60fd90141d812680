"""DJI's XMP packets in JPEG files: both forms, broken files, gimbal angles and RTK sigmas."""

import math

import numpy as np
import pytest
from PIL import Image

from bundle import InputError
from bundle.georeference.attitudes import read_attitudes
from bundle.georeference.exif_gps import read_dji, read_exif_gps, xmp_packet
from tests.scenes import make_problem

HEAD = (
    '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'
    '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="DJI Meta Data" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'
)
TAIL = '</rdf:RDF></x:xmpmeta>\n<?xpacket end="w"?>'
VALUES = {
    "GimbalYawDegree": "-124.40",
    "GimbalPitchDegree": "-89.90",
    "GimbalRollDegree": "+0.00",
    "FlightYawDegree": "+7.10",
    "RtkStdLon": "0.03",
    "RtkStdLat": "0.04",
    "RtkStdHgt": "0.09",
    "Version": "not a number",
}
ANGLES = (-124.4, -89.9, 0.0)


def attributes(values=VALUES):
    inner = "".join(f' drone-dji:{name}="{value}"' for name, value in values.items())
    return f"{HEAD}{inner}/>{TAIL}".encode()


def elements(values=VALUES):
    inner = "".join(f"<drone-dji:{n}>{v}</drone-dji:{n}>" for n, v in values.items())
    return f"{HEAD}>{inner}</rdf:Description>{TAIL}".encode()


def segment(content, marker=0xE1):
    return bytes([0xFF, marker]) + (len(content) + 2).to_bytes(2, "big") + content


def photograph(path, packet, *, position=False):
    """A JPEG file of Pillow's with a packet after its first segments."""
    image = Image.new("RGB", (16, 12))
    tags = image.getexif()
    if position:
        gps = tags.get_ifd(0x8825)
        gps.update({1: "N", 2: (50.0, 30.0, 0.0), 3: "E", 4: (4.0, 0.0, 0.0), 5: 0, 6: 100.0})
        gps[31] = 7.5
    image.save(path, exif=tags)
    data = path.read_bytes()
    body = b"" if packet is None else segment(b"http://ns.adobe.com/xap/1.0/\0" + packet)
    path.write_bytes(data[:2] + segment(b"Other\0", 0xE5) + body + data[2:])
    return path


@pytest.mark.parametrize("form", [attributes, elements])
def test_both_forms_are_read(tmp_path, form):
    record = read_dji(photograph(tmp_path / "a.jpg", form() + b"\0" * 20))
    assert record[:3] == ANGLES
    assert record.horizontal == pytest.approx(math.sqrt((0.03**2 + 0.04**2) / 2))
    assert record.vertical == 0.09
    with Image.open(tmp_path / "a.jpg") as image:
        assert image.size == (16, 12)


def test_packets_of_others_and_broken_ones_have_no_values(tmp_path):
    foreign = attributes().replace(b"www.dji.com/drone-dji", b"example.org/drone-dji")
    for packet in (None, b"", b"<x:xmpmeta", foreign, attributes()[:-30], b"\xff\xfe\x00"):
        record = read_dji(photograph(tmp_path / "a.jpg", packet))
        assert not record.has_angles and math.isnan(record.horizontal)
    without = {name: value for name, value in VALUES.items() if "Roll" not in name}
    assert not read_dji(photograph(tmp_path / "a.jpg", attributes(without))).has_angles
    zero = {**VALUES, "RtkStdLon": "0", "RtkStdLat": "0", "RtkStdHgt": "-1"}
    record = read_dji(photograph(tmp_path / "a.jpg", attributes(zero)))
    assert record.has_angles and math.isnan(record.horizontal) and math.isnan(record.vertical)


def test_cut_and_foreign_files_have_no_packet(tmp_path):
    path = photograph(tmp_path / "a.jpg", attributes())
    whole = path.read_bytes()
    for count in (0, 1, 2, 3, 5, 10, 40, 200):
        path.write_bytes(whole[:count])
        assert not read_dji(path).has_angles
    path.write_bytes(bytes([0xFF, 0xD8, 0xFF, 0xD0, 0xFF, 0xFF]) + whole[3:])  # fill, no length
    assert read_dji(path).has_angles
    Image.new("RGB", (4, 4)).save(tmp_path / "b.png")
    assert xmp_packet(tmp_path / "b.png") is None


def test_angles_become_orientations(tmp_path):
    problem = make_problem(num_images=3).replace(image_names=("a.jpg", "b.jpg", "c.jpg"))
    photograph(tmp_path / "a.jpg", attributes())
    photograph(tmp_path / "b.jpg", None)
    found = read_attitudes(problem, orientations="xmp", images=tmp_path, orientation_sigma="4/2")
    (prior,) = found.priors
    assert prior.image == problem.image_ids[0]
    assert tuple(prior.sigma_degrees) == (4, 2)
    assert len(found.notes) == 2
    (tmp_path / "a.jpg").unlink()
    with pytest.raises(InputError, match="gimbal"):
        read_attitudes(problem, orientations="xmp", images=tmp_path)
    with pytest.raises(InputError, match="folder"):
        read_attitudes(problem, orientations="xmp")


def test_positions_have_the_sigmas_of_rtk(tmp_path):
    photograph(tmp_path / "a.jpg", attributes(), position=True)
    photograph(tmp_path / "b.jpg", None, position=True)
    found = read_exif_gps(tmp_path, ["a.jpg", "b.jpg"])
    np.testing.assert_allclose(found.accuracy[0], [math.sqrt(0.00125), 0.09])
    np.testing.assert_allclose(found.accuracy[1], [7.5, np.nan])
