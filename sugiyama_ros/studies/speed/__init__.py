"""How fast the package is: ratios to floors, to other ways of calibration, and between commands.

    python -m sugiyama_ros.studies.speed [--part NAME] [--json] [--write docs/speed.md]

Each part is one module with a function ``measure``; `sugiyama_ros.studies.speed.parts` lists them. All times are CPU
times. What is compared is measured in turn, several times over, and the shortest time counts. So a ratio hardly
depends on what else the machine does.
"""
