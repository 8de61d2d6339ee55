"""Public data sets that ``sugiyama fetch`` can download: address, content and licence."""

from dataclasses import dataclass

#: Checksum of ``case1.data``, the experiment of the paper.
SUGIYAMA_CASE_1_SHA256 = "91cf02c7cbf3fe6d817dd02ef347586b12a9134b1f914655e486be2f8773457c"


@dataclass(frozen=True)
class DataSet:
    """A public archive: a zip file, of which one ``.data`` file is used."""

    url: str
    size_bytes: int
    sha256: str
    member: str
    licence: str


CATALOGUE = {
    "sugiyama2008": DataSet(
        url="https://mathematical-society-of-traffic-flow.github.io/assets/data/data.zip",
        size_bytes=275_807,
        sha256="751ec706d55b911e775deeb9436f2c340245883a4b7a567206411a1dcdba6fe4",
        member="case1.data",
        licence=(
            "The Mathematical Society of Traffic Flow allows the use of this data for academic research and for"
            " non-commercial purposes. Users cite New J. Phys. 10 (2008) 033001 and New J. Phys. 11 (2009)"
            " 083025. The data may not be passed on to others: give them the address instead."
        ),
    ),
}
