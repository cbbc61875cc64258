"""python -m proground_log.cli"""

from proground_log.cli import main

main()
