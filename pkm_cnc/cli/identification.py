"""What pkm_cnc identify does: bags in; estimates, machine file and page out."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pkm_cnc.array_path import respond
from pkm_cnc.bag import read_run
from pkm_cnc.cli.arguments import make_folder, setup_of, write_text
from pkm_cnc.compensation import nominal
from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.identification import (
    AxisData,
    ContourData,
    DriveData,
    DriveFit,
    DriveRun,
    FrequencyResponse,
    Network,
    drive_run,
    drive_setup,
    drive_unknowns,
    fit_drives,
    fit_drives_by_networks,
    frequency_response,
    identified_setup,
    identified_yaml,
)
from pkm_cnc.plant import DEAD_TIME
from pkm_cnc.report import Page, Table, parameter_tables, text_table, write_page
from pkm_cnc.report.identification_report import (
    bandwidth_table,
    deviation_table,
    estimate_table,
    identification_data,
    response_figure,
    singular_table,
)

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> None:
    """Do what the arguments say. Raises InputError."""
    if arguments.seed < 0:
        raise InputError(f"--seed: {arguments.seed} is below its minimum 0")
    setup = _believed(setup_of(arguments))
    runs = [drive_run(read_run(bag), setup) for bag in arguments.bag]
    if arguments.report:
        make_folder(Path(arguments.report))
    fits, networks = _fits(setup, runs, arguments.data, arguments.method, arguments.seed)
    found = identified_setup(setup, fits)
    tables = [estimate_table(fits), deviation_table(fits), bandwidth_table(found), singular_table(fits)]
    write_text(arguments.output, identified_yaml(setup, fits, [Path(bag).name for bag in arguments.bag]))
    print("\n\n".join(map(text_table, tables)))
    print(f"machine {arguments.output}")
    if arguments.report:
        page = _page(setup, found, runs, fits, tables, arguments.command)
        for network in networks:
            network.save(Path(arguments.report) / f"network-{network.name}.json")
        print(f"report {write_page(Path(arguments.report), page)[-1]}")


def _believed(setup: Setup) -> Setup:
    """What a linear model can have of `setup`: of a machine with friction, backlash and the like its nominal part."""
    imperfect = {setup.imperfect(axis) for axis in setup.axes} - {"", DEAD_TIME}
    return nominal(setup) if imperfect else setup


def _fits(
    setup: Setup, runs: Sequence[DriveRun], data: str, method: str, seed: int
) -> tuple[list[DriveFit], list[Network]]:
    """The fits, and of each the network that saw the wide band, if there are any."""
    problems: list[tuple[list[str], DriveData]]
    if data == "contour":
        problems = [(list(setup.axes), ContourData(runs))]
    else:
        problems = [([axis], AxisData(axis, runs)) for axis in setup.axes]
    fits, networks = [], []
    for axes, observed in problems:
        unknowns = drive_unknowns(setup, axes)
        if method == "nn":
            fit, (first, *_) = fit_drives_by_networks(setup, unknowns, observed, seed=seed)
            fits.append(fit)
            networks.append(first)
        else:
            fits.append(fit_drives(setup, unknowns, observed))
    return fits, networks


def _page(
    setup: Setup, found: Setup, runs: Sequence[DriveRun], fits: list[DriveFit], tables: list[Table], command: str
) -> Page:
    responses = _responses(found, max(runs, key=lambda run: len(run.path)))
    return Page(
        title=f"Drives of the {setup.machine_name}",
        question="Which drives explain what was recorded?",
        command=command,
        tables=tables,
        figures=[response_figure(*responses)],
        parameters=parameter_tables(setup),
        data=identification_data(fits),
    )


def _responses(found: Setup, run: DriveRun) -> tuple[dict[str, FrequencyResponse], dict[str, FrequencyResponse]]:
    """Frequency responses by drive, as recorded in the longest run and of the identified model."""
    model = drive_setup(found, (), np.array([]))
    recorded, modelled = {}, {}
    for axis, setpoint in run.setpoints.items():
        recorded[axis] = frequency_response(setpoint[0], run.readings[axis], found.servo_period)
        answer = respond(model, axis, *setpoint).position
        modelled[axis] = frequency_response(setpoint[0], answer, found.servo_period)
    return recorded, modelled
