"""Texts of which no integrator is made."""

import openmm
from test_copies_elsewhere import changed

from every_integrator import made
from refusals import assert_refused, for_each, refused


def without_settings(engine):
    text = openmm.XmlSerializer.serialize(made(engine=engine))
    before, name, after = text.partition('kineticEnergyExpression="')
    openmm.XmlSerializer.deserialize(before + name + "m*v*v/2" + after[after.index('"') :])


@refused(
    *(
        (lambda parts=parts: openmm.XmlSerializer.deserialize(changed(made(), **parts)), sentence)
        for parts, sentence in [
            (
                {"class": "os.system"},
                "class os.system of this integrator does not exist in this process: import its",
            ),
            ({"class": "builtins.int"}, "the class builtins.int of this integrator does not exist"),
            ({"arguments": {"volume": 3}}, "another version of openmm_exactrb wrote this integrator, .*volume"),
            ({"arguments": {"thermostat": {"thermostat": ["Popen", {}]}}}, r"another version of .*Popen"),
            ({"arguments": {"scheme": {"pickle": "gASVBgAAAAAAAACMAmE="}}}, r"another version of .*pickle"),
            ({"arguments": {"scheme": {"scheme": "W9"}}}, "the scheme 'W9' is unknown"),
        ]
    ),
    *for_each(without_settings, r"written by an earlier version .* create the integrator again", ["host", "auto"]),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
