"""The four papers, and the groups of items beyond them."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BEYOND", "ERRATA", "GROUPS", "S0", "S1", "S2", "S3", "Paper"]


@dataclass(frozen=True)
class Paper:
    """A source of claims: a paper, or the library's own studies.

    Attributes
    ----------
    key : str
        Beginning of the names of its items.
    citation : str
        Authors, year, title.
    """

    key: str
    citation: str


S0 = Paper(
    "s0",
    "Uribe-Murcia, Shmaliy and Andrade-Lucio (2018), "
    "GPS-based tracking over WSNs with delayed and missing data using UFIR filtering",
)
S1 = Paper(
    "s1",
    "Uribe-Murcia, Ortega-Contreras, Pale-Ramon, Vazquez-Olguin and Shmaliy (2022), A comparison of the "
    "Kalman filter and the unbiased FIR filter for network systems with multiples output delays and "
    "lost data",
)
S2 = Paper(
    "s2",
    "Uribe-Murcia, Andrade-Lucio, Shmaliy and Xu (2019), "
    "Unbiased FIR filtering under Bernoulli-distributed binary randomly delayed and missing data",
)
S3 = Paper(
    "s3",
    "Kim (2019), A unified finite memory structure filter and smoother "
    "and its application to target tracking in wireless network environments",
)
ERRATA = Paper(
    "errata", "Printed equations of the four papers that are wrong: to differ, explained, is what is claimed"
)
BEYOND = Paper("beyond", "Beyond the papers: robustness, real tracks, certificates, peers")

GROUPS = (S0, S1, S2, S3, ERRATA, BEYOND)
