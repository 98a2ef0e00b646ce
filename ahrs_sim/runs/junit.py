"""Results for CI systems: JUnit XML."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as Xml


@dataclass(frozen=True)
class Case:
    """One test case."""

    group: str
    name: str
    failure: str | None = None  # message; None: passed
    details: str | None = None


def document(title: str, cases: Sequence[Case], errors: Mapping[str, str]) -> str:
    """Write cases, and a failed one for each flight that did not complete (`errors`, by flight)."""
    suite = Xml.Element("testsuite", name=title)
    every = [*cases, *(Case("flight", where, error) for where, error in errors.items())]
    for case in every:
        element = Xml.SubElement(suite, "testcase", classname=case.group, name=case.name)
        if case.failure is not None:
            Xml.SubElement(element, "failure", message=case.failure).text = case.details
    suite.set("tests", str(len(every)))
    suite.set("failures", str(sum(case.failure is not None for case in every)))
    return Xml.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
