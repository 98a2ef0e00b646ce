"""Results for CI systems: JUnit XML."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as Xml


@dataclass(frozen=True)
class Case:
    """One test case."""

    group: str
    name: str
    seconds: float  # that it took
    failure: str | None = None  # message; None: passed
    details: str | None = None


def document(title: str, cases: Sequence[Case]) -> str:
    """Write cases as a test suite, with the time of each and of all."""
    suite = Xml.Element("testsuite", name=title)
    for case in cases:
        element = Xml.SubElement(suite, "testcase", classname=case.group, name=case.name, time=f"{case.seconds:.3f}")
        if case.failure is not None:
            Xml.SubElement(element, "failure", message=case.failure).text = case.details
    suite.set("tests", str(len(cases)))
    suite.set("failures", str(sum(case.failure is not None for case in cases)))
    suite.set("time", f"{sum(case.seconds for case in cases):.3f}")
    return Xml.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
