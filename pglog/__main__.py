"""python -m pglog"""

from pglog.commands import main

main()
