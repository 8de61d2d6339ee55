"""How fast the package is: ratios to floors, to other ways of calibration, and between commands.

    python -m benchmarks.speed [--part NAME] [--json] [--write benchmarks/results/DATE-speed.md]

All times are CPU times. What is compared is measured in turn, several times over, and the shortest time counts. So a
ratio hardly depends on what else the machine does. The recording is simulated: 22 drivers who start out of a jam, for
250 s. "at most" is the aim.
"""
