"""The command `pzcap`: footage in, cameras and bodies to every tool. No simulator and no configuration framework.

`main` is its entry and lists what there is; every other module is one thing that it does.
"""
