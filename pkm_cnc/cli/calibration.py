"""What pkm_cnc calibrate does: measurements in; estimate, machine file and page out."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pkm_cnc.bag import read_run
from pkm_cnc.cli.arguments import make_folder, setup_of, write_text
from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.identification import (
    Calibration,
    Circle,
    NetworkCalibration,
    Positions,
    by_approach,
    calibrate,
    calibrate_by_networks,
    calibrated_yaml,
    positioning,
    positions_of_run,
    read_measurements,
)
from pkm_cnc.report import Page, Table, parameter_tables, text_table, write_page
from pkm_cnc.report.calibration_report import (
    calibration_data,
    calibration_table,
    convergence_table,
    deviation_figure,
    deviation_table,
    positioning_table,
)

__all__ = ["run"]


@dataclass(frozen=True)
class _Outcome:
    measurements: Positions | Circle
    calibration: Calibration
    networks: NetworkCalibration | None


def run(arguments: argparse.Namespace) -> None:
    """Do what the arguments say. Raises InputError."""
    _check_seed(arguments.seed)
    setup = setup_of(arguments)
    sources = arguments.bag or [arguments.measurements]
    measurements = _measured(arguments, setup)
    if arguments.report:
        make_folder(Path(arguments.report))
    outcome = _outcome(setup, measurements, arguments)
    tables = _tables(outcome)
    write_text(arguments.output, calibrated_yaml(setup, outcome.calibration, [Path(path).name for path in sources]))
    print("\n\n".join(map(text_table, tables)))
    print(f"machine {arguments.output}")
    if arguments.report:
        for number, network in enumerate(outcome.networks.networks if outcome.networks else (), 1):
            network.save(Path(arguments.report) / f"network-{number}.json")
        print(f"report {write_page(Path(arguments.report), _page(setup, outcome, tables, arguments.command))[-1]}")


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise InputError(f"--seed: {seed} is below its minimum 0")


def _measured(arguments: argparse.Namespace, setup: Setup) -> Positions | Circle:
    if arguments.measurements:
        return read_measurements(arguments.measurements, setup.kinematics)
    parts = [positions_of_run(read_run(bag), setup) for bag in arguments.bag]
    return Positions(np.concatenate([part.joints for part in parts]), np.concatenate([part.tcp for part in parts]))


def _outcome(setup: Setup, measurements: Positions | Circle, arguments: argparse.Namespace) -> _Outcome:
    machine, tilt = setup.kinematics, arguments.tilt
    if arguments.method == "nn":
        found = calibrate_by_networks(machine, measurements, seed=arguments.seed, tilt=tilt)
        return _Outcome(measurements, found.calibration, found)
    return _Outcome(measurements, calibrate(machine, measurements, tilt=tilt), None)


def _tables(outcome: _Outcome) -> list[Table]:
    calibration = outcome.calibration
    tables = [calibration_table(calibration), deviation_table(calibration)]
    if outcome.networks is not None:
        tables.append(convergence_table(outcome.networks))
    if isinstance(outcome.measurements, Positions) and outcome.measurements.targets is not None:
        targets = outcome.measurements.targets
        tests = {
            "before": positioning(by_approach(targets, calibration.before)),
            "after": positioning(by_approach(targets, calibration.after)),
        }
        tables.append(positioning_table("Positioning test", tests))
    return tables


def _page(setup: Setup, outcome: _Outcome, tables: list[Table], command: str) -> Page:
    tcp = outcome.measurements.tcp if isinstance(outcome.measurements, Positions) else None
    history = None if outcome.networks is None else outcome.networks.history
    return Page(
        title=f"Calibration of the {setup.machine_name}",
        question="Which geometry explains what was measured?",
        command=command,
        tables=tables,
        figures=[deviation_figure(outcome.calibration, setup.kinematics.coordinates, tcp, history)],
        parameters=parameter_tables(setup),
        data=calibration_data(outcome.calibration),
    )
