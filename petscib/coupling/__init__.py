"""Spreading and interpolation between markers and grid."""
