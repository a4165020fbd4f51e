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
    finding : str
        What holds of it, in a few sentences; the numbers are in the claims.
    """

    key: str
    citation: str
    finding: str


S0 = Paper(
    "s0",
    "Uribe-Murcia, Shmaliy and Andrade-Lucio (2018), GPS-based tracking over WSNs with delayed and "
    "missing data using UFIR filtering",
    "The Kalman filter's error grows faster with the delay than that of UFIR: so it does for the Kalman "
    "filter of the paper, which takes the noise of late data for white; the exact one is better than UFIR"
    " at every delay. H-infinity with its best theta is no better than the exact Kalman filter, and with "
    "a fixed theta it is soon where no such filter exists. One horizon for all delays costs little; that "
    "the best one grows with the delay is not seen.",
)
S1 = Paper(
    "s1",
    "Uribe-Murcia, Ortega-Contreras, Pale-Ramon, Vazquez-Olguin and Shmaliy (2022), A comparison of the "
    "Kalman filter and the unbiased FIR filter for network systems with multiples output delays and lost "
    "data",
    "UFIR does not depend on Q and R, and the Kalman filter does, as the paper says. Time stamps help "
    "where the model fits. With the printed Q the Kalman filter cannot follow a drive through a city, and"
    " much of the comparison is about that; with a Q that fits the two filters are close.",
)
S2 = Paper(
    "s2",
    "Uribe-Murcia, Andrade-Lucio, Shmaliy and Xu (2019), Unbiased FIR filtering under "
    "Bernoulli-distributed binary randomly delayed and missing data",
    "Which filter is better when, the least error at the true delay factor among those of the tables, and"
    " that UFIR does not depend on beta are reproduced; the absolute errors belong to a track that is not"
    " public. H-infinity diverges because the printed gain does not belong to the printed condition: with"
    " the gain that does it stays.",
)
S3 = Paper(
    "s3",
    "Kim (2019), A unified finite memory structure filter and smoother and its application to target "
    "tracking in wireless network environments",
    "Table 2 is reproduced in the metric that its numbers imply, which is not the root mean square that "
    "it names. By true RMS the two filters are equal within a per cent at these accelerations; at larger "
    "ones the finite window is better, because it forgets a jump exactly after M steps.",
)
ERRATA = Paper(
    "errata",
    "Printed equations of the four papers that are wrong",
    "Each is computed as printed, as the library has it, and a third way that uses neither. That it "
    "differs from print and agrees with the third is what is claimed, so that every one of these differs,"
    " explained.",
)
BEYOND = Paper(
    "beyond",
    "Beyond the papers",
    "Filters that are told wrong noises, outliers and manoeuvres, real tracks; the exact filters beside "
    "those of the papers; a certificate for each gain that is used; the same data through other "
    "libraries.",
)

GROUPS = (S0, S1, S2, S3, ERRATA, BEYOND)
