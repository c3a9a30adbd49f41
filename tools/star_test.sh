#!/bin/sh
# The star test on the Tripod through the ROS graph: written, run and recorded, evaluated. Needs the .venv.
set -eu
cd "$(dirname "$0")/.."
mkdir -p bags
n=1
while [ -n "$(find bags -maxdepth 1 \( -name "star-$n" -o -name "star-$n[.-]*" \) | head -n 1)" ]; do n=$((n + 1)); done
bag=bags/star-$n

.venv/bin/pkm_cnc program star --machine tripod --feed 6000 --headings=-15:105:15 --pivot 0 0 --length 200 -o "$bag.ngc"
.venv/bin/pkm_cnc run "$bag.ngc" --machine tripod --bag "$bag"
.venv/bin/pkm_cnc evaluate "$bag" --report "$bag-report"
echo "program $bag.ngc, bag $bag"
