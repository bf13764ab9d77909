"""`python -m joulebox_agent` is the command `joulebox-agent`."""

from joulebox_agent.cli import main

if __name__ == "__main__":
    main()
