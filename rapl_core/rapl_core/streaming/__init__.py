"""From a stream of states and embeddings to one reward an episode; knows neither ROS nor torch."""
