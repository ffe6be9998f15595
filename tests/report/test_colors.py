import numpy as np
import pytest

from fsh3d_o3d.report.colors import color_stops, css_color, error_colors, to_linear, to_srgb


def cie_lightness(srgb):
    """CIE 1976 L*, from the definition of sRGB: another scale of lightness than the one the ramp is built on."""
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)


def test_lightness_falls_steadily_over_the_ramp():
    lightness = cie_lightness(error_colors(np.linspace(0, 1, 200)))
    steps = -np.diff(lightness)
    assert lightness[0] > 93
    assert lightness[-1] < 30
    assert steps.min() > 0
    # Even in another lightness scale no stretch is more than twice as steep as the average.
    assert steps.max() < 2 * steps.mean()


def test_neighbouring_errors_have_neighbouring_colours():
    colors = error_colors(np.linspace(0, 1, 1000))
    # A thousand steps over a path of some two units in RGB: about 0.003 a step with room for bends.
    assert np.abs(np.diff(colors, axis=0)).max() < 0.01
    assert colors.min() >= 0
    assert colors.max() <= 1


def test_scale_ends_at_the_largest_or_at_the_maximum():
    values = np.array([0.0, 1.0, 2.0])
    np.testing.assert_array_equal(error_colors(values), error_colors(10 * values))
    np.testing.assert_array_equal(error_colors(values, 1.0)[1], error_colors(values, 1.0)[2])
    np.testing.assert_array_equal(error_colors(values, 4.0)[2], error_colors(values)[1])


def test_no_error_is_pale_and_unknown_is_grey():
    np.testing.assert_array_equal(error_colors([0.0, 0.0]), error_colors([0.0, 1.0])[[0, 0]])
    colors = error_colors([np.nan, 0.0, 1.0, np.inf])
    assert np.ptp(colors[0]) == 0
    np.testing.assert_array_equal(colors[3], colors[2])
    np.testing.assert_array_equal(error_colors([np.nan])[0], colors[0])
    assert error_colors([]).shape == (0, 3)


@pytest.mark.parametrize(
    ("values", "maximum"), [([-1.0], None), ([[1.0]], None), ([1.0], 0), ([1.0], -1), ([1.0], np.nan)]
)
def test_bad_errors_are_refused(values, maximum):
    with pytest.raises(ValueError):
        error_colors(values, maximum)


def test_stops_are_the_ramp():
    stops = color_stops(5)
    expected = [css_color(color) for color in error_colors(np.linspace(0, 1, 5))]
    # Written with eight bits a channel, and the ramp is tabulated in 256 steps: the last digit may differ.
    for (_, found), wanted in zip(stops, expected, strict=True):
        difference = np.array([int(found[i : i + 2], 16) - int(wanted[i : i + 2], 16) for i in (1, 3, 5)])
        assert np.abs(difference).max() <= 2
    assert [position for position, _ in stops] == [0, 0.25, 0.5, 0.75, 1]


def test_srgb_and_linear_are_inverse():
    values = np.linspace(0, 1, 300)
    # The standard's two pieces meet to some 1e-8, no better.
    np.testing.assert_allclose(to_srgb(to_linear(values)), values, atol=1e-7)
    assert to_linear(0.5) == pytest.approx(0.214041, abs=1e-6)  # IEC 61966-2-1
