"""The models of diagrams/simulink as they are drawn: a house with a thermostat, a bouncing ball, a motor with a PID.

`python -m tests.support.simulink_models` writes their files.
"""

from __future__ import annotations

from pathlib import Path

from blocks.simulink import Annotation, Mask, Model
from tests.support.places import ROOT
from tests.support.simulink_files import block, line, model, system, write_mdl, write_split

FOLDER = ROOT / "diagrams" / "simulink"


def _at(x: int, y: int, width: int = 40, height: int = 30) -> dict[str, str]:
    return {"Position": f"[{x}, {y}, {x + width}, {y + height}]"}


def thermostat() -> Model:
    """Return a room between the weather and a heater that a relay turns on and off; times in h."""
    inside = system(
        [
            block("Inport", "heat", 21, {"Port": "1"} | _at(20, 40), {"out": 1}),
            block("Inport", "outside", 22, {"Port": "2"} | _at(20, 140), {"out": 1}),
            block("Sum", "difference", 23, {"Inputs": "+-"} | _at(100, 140), {"in": 2, "out": 1}),
            block("Gain", "losses", 24, {"Gain": "1/R"} | _at(180, 140), {"in": 1, "out": 1}),
            block("Sum", "balance", 25, {"Inputs": "++"} | _at(260, 40), {"in": 2, "out": 1}),
            block("Gain", "1/C", 26, {"Gain": "1/C"} | _at(340, 40), {"in": 1, "out": 1}),
            block("Integrator", "room", 27, {"InitialCondition": "T_start"} | _at(420, 40), {"in": 1, "out": 1}),
            block("Outport", "T", 28, {"Port": "1"} | _at(520, 40), {"in": 1}),
        ],
        [
            line(("heat", "1"), ("balance", "1")),
            line(("outside", "1"), ("difference", "1")),
            line(("difference", "1"), ("losses", "1")),
            line(("losses", "1"), ("balance", "2")),
            line(("balance", "1"), ("1/C", "1")),
            line(("1/C", "1"), ("room", "1")),
            line(("room", "1"), ("T", "1"), ("difference", "2")),
        ],
    )
    mask = Mask("House", {"R": "resistance", "C": "capacity", "T_start": "15"})
    relay = {"OnSwitchValue": "1", "OffSwitchValue": "-1", "OnOutputValue": "power", "OffOutputValue": "0"}
    weather = {"Amplitude": "5", "Bias": "8", "Frequency": "2*pi/24", "Phase": "-pi/2"}
    outside = system(
        [
            block("Constant", "Set point\n[degC]", 1, {"Value": "20"} | _at(20, 60), {"out": 1}),
            block("Sum", "e", 2, {"Inputs": "|+-", "IconShape": "round"} | _at(120, 60, 30), {"in": 2, "out": 1}),
            block("Relay", "Thermostat", 3, relay | _at(200, 60), {"in": 1, "out": 1}),
            block("Sin", "Weather", 4, weather | _at(200, 150), {"out": 1}),
            block("SubSystem", "House", 5, _at(320, 60, 60, 120), {"in": 2, "out": 1}, inside=inside, mask=mask),
            block("Scope", "Temperatures", 6, _at(460, 150), {"in": 2}),
            block("ToWorkspace", "To Workspace", 7, {"VariableName": "T_room"} | _at(460, 60, 60), {"in": 1}),
        ],
        [
            line(("Set point\n[degC]", "1"), ("e", "1")),
            line(("e", "1"), ("Thermostat", "1")),
            line(("Thermostat", "1"), ("House", "1"), name="heat"),
            line(("Weather", "1"), ("House", "2"), ("Temperatures", "2")),
            line(("House", "1"), ("e", "2"), ("Temperatures", "1"), ("To Workspace", "1")),
        ],
        [Annotation("A house and its thermostat. Time in h, heat in kW.", "[20, 10]")],
    )
    given = {"StopTime": "48", "SolverName": "ode45", "RelTol": "1e-6"}
    code = "resistance = 4; % K/kW\ncapacity = 2.5; % kWh/K\npower = 8; % kW"
    return model("thermostat", outside, settings=given, callbacks={"InitFcn": code})


def bouncing_ball() -> Model:
    """Return a ball whose speed is reset where its height falls through 0; the state port gives the speed before."""
    speed = {"ExternalReset": "falling", "InitialConditionSource": "external", "ShowStatePort": "on"}
    drawn = system(
        [
            block("Constant", "g", 1, {"Value": "-9.81"} | _at(20, 50), {"out": 1}),
            block("Integrator", "Speed", 3, speed | _at(200, 40, 40, 90), {"in": 3, "out": 1, "state": 1}),
            block("Integrator", "Height", 4, {"InitialCondition": "10"} | _at(320, 60), {"in": 1, "out": 1}),
            block("Gain", "Bounce", 5, {"Gain": "-e"} | _at(200, 190), {"in": 1, "out": 1}),
            block("InitialCondition", "IC", 6, {"Value": "15"} | _at(100, 190), {"in": 1, "out": 1}),
            block("Scope", "Ball", 7, _at(440, 60), {"in": 2}),
        ],
        [
            line(("g", "1"), ("Speed", "1")),
            line(("Speed", "1"), ("Height", "1"), ("Ball", "2")),
            line(("Speed", "state"), ("Bounce", "1")),
            line(("Bounce", "1"), ("IC", "1")),
            line(("IC", "1"), ("Speed", "3")),
            line(("Height", "1"), ("Ball", "1"), ("Speed", "2")),
        ],
    )
    return model(
        "bouncing_ball", drawn, settings={"StopTime": "12", "SolverName": "ode45"}, callbacks={"PreLoadFcn": "e = 0.8;"}
    )


def motor_pid() -> Model:
    """Return a motor whose shaft an encoder counts; a PID on a processor holds its speed."""
    motor = system(
        [
            block("Inport", "v", 31, {"Port": "1"} | _at(20, 40), {"out": 1}),
            block("Sum", "U", 32, {"Inputs": "+-"} | _at(100, 40), {"in": 2, "out": 1}),
            block(
                "TransferFcn",
                "Armature",
                33,
                {"Numerator": "[1]", "Denominator": "[L R]"} | _at(180, 40, 80),
                {"in": 1, "out": 1},
            ),
            block("Gain", "Torque", 34, {"Gain": "k"} | _at(300, 40), {"in": 1, "out": 1}),
            block(
                "TransferFcn",
                "Rotor",
                35,
                {"Numerator": "[1]", "Denominator": "[J b]"} | _at(380, 40, 80),
                {"in": 1, "out": 1},
            ),
            block("Integrator", "Angle", 36, _at(500, 40), {"in": 1, "out": 1}),
            block("Gain", "EMF", 37, {"Gain": "k"} | _at(300, 140), {"in": 1, "out": 1}),
            block("Outport", "phi", 38, {"Port": "1"} | _at(600, 40), {"in": 1}),
            block("Outport", "omega", 39, {"Port": "2"} | _at(600, 140), {"in": 1}),
        ],
        [
            line(("v", "1"), ("U", "1")),
            line(("U", "1"), ("Armature", "1")),
            line(("Armature", "1"), ("Torque", "1"), name="i"),
            line(("Torque", "1"), ("Rotor", "1")),
            line(("Rotor", "1"), ("Angle", "1"), ("EMF", "1"), ("omega", "1")),
            line(("EMF", "1"), ("U", "2")),
            line(("Angle", "1"), ("phi", "1")),
        ],
    )
    values = {"R": "1.2", "L": "0.01", "k": "0.1", "J": "2e-3", "b": "1e-4"}
    mask = Mask("DC motor", values)
    pid = {
        "SourceBlock": "simulink/Discrete/Discrete PID Controller", "SourceType": "PID 1dof", "Controller": "PI",
        "TimeDomain": "Discrete-time", "P": "kp", "I": "ki", "SampleTime": "Ts", "IntegratorMethod": "Forward Euler",
        "LimitOutput": "on", "UpperSaturationLimit": "24", "LowerSaturationLimit": "-24",
        "AntiWindupMode": "back-calculation", "Kb": "2",
    }  # fmt: skip
    difference = {
        "SourceBlock": "simulink/Discrete/Discrete Derivative",
        "SourceType": "Discrete Derivative",
        "gainval": "1.0",
    }
    drawn = system(
        [
            block("Step", "Wanted\nspeed", 1, {"Time": "0.1", "After": "60"} | _at(20, 60), {"out": 1}),
            block("Sum", "e", 2, {"Inputs": "|+-", "IconShape": "round"} | _at(110, 60, 30), {"in": 2, "out": 1}),
            block("Reference", "Controller", 3, pid | _at(180, 55, 60, 40), {"in": 1, "out": 1}),
            block("SubSystem", "Motor", 4, values | _at(320, 55, 60, 60), {"in": 1, "out": 2}, inside=motor, mask=mask),
            block("Gain", "Counts", 5, {"Gain": "200/(2*pi)"} | _at(460, 160), {"in": 1, "out": 1}),
            block("Quantizer", "Encoder", 6, {"QuantizationInterval": "1"} | _at(380, 160), {"in": 1, "out": 1}),
            block("ZeroOrderHold", "Sampler", 7, {"SampleTime": "Ts"} | _at(300, 160), {"in": 1, "out": 1}),
            block("Reference", "Speed", 8, difference | _at(190, 160, 60), {"in": 1, "out": 1}),
            block("Gain", "rad//s", 9, {"Gain": "2*pi/200"} | _at(110, 160), {"in": 1, "out": 1}),
            block("Outport", "omega", 10, {"Port": "1"} | _at(460, 90), {"in": 1}),
            block("ToWorkspace", "Log", 11, {"VariableName": "voltage"} | _at(280, 10, 60), {"in": 1}),
        ],
        [
            line(("Wanted\nspeed", "1"), ("e", "1")),
            line(("e", "1"), ("Controller", "1")),
            line(("Controller", "1"), ("Motor", "1"), ("Log", "1")),
            line(("Motor", "1"), ("Counts", "1")),
            line(("Motor", "2"), ("omega", "1")),
            line(("Counts", "1"), ("Encoder", "1")),
            line(("Encoder", "1"), ("Sampler", "1")),
            line(("Sampler", "1"), ("Speed", "1")),
            line(("Speed", "1"), ("rad//s", "1")),
            line(("rad//s", "1"), ("e", "2")),
        ],
    )
    return model("motor_pid", drawn, settings={"StopTime": "0.5", "SolverName": "VariableStepAuto"})


MODELS = (thermostat, bouncing_ball, motor_pid)


def write(folder: Path = FOLDER) -> None:
    """Write the thermostat as text, the ball as text and as a package, the motor as a package, and its variables."""
    folder.mkdir(exist_ok=True)
    write_mdl(thermostat(), folder)
    write_split(bouncing_ball(), folder)
    write_split(motor_pid(), folder)
    (folder / "motor_pid.m").write_text("% variables of motor_pid.slx\nTs = 0.005; % s\nkp = 0.5;\nki = 3;\n")


if __name__ == "__main__":
    write()


__all__ = ["FOLDER", "MODELS", "bouncing_ball", "motor_pid", "thermostat", "write"]
