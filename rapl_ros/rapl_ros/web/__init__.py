"""The page on which people rank videos and watch the system: server and front end.

Free of ROS: the node ``web`` brings the graph in through :mod:`rapl_ros.web.ports`.
"""
