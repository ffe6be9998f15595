"""Opens pages in headless Chromium. Without one, outside of CI, the page's structure is checked instead."""

import os
import re
import shutil
import subprocess

from tests.report.pages import HOSTILE, check_structure, write_page
from tests.report.shapes import ball_points

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1280,1400",
    "--virtual-time-budget=30000",
]

# What a reader does, as far as the page's script can tell: touch a view, and turn it.
TURN = """
<script>
const wait = setInterval(() => {
  if (document.documentElement.dataset.rendered !== "true") return;
  clearInterval(wait);
  const plots = ["plot-original", "plot-reconstruction", "plot-error"].map((id) => document.getElementById(id));
  plots[1].dispatchEvent(new Event("pointerdown"));
  const { up, center } = plots[1].layout.scene.camera;
  Plotly.relayout(plots[1], { "scene.camera": { eye: { x: 0.5, y: 1.25, z: -0.75 }, up, center } });
  setTimeout(() => {
    const eyes = plots.map((plot) => plot._fullLayout.scene._scene.getCamera().eye);
    document.documentElement.dataset.eyes = eyes.map((eye) => [eye.x, eye.y, eye.z].map((v) => v.toFixed(3))).join(" ");
  }, 3000);
}, 100);
</script>
</body>"""


def opened(path, profile, *flags):
    """The attributes of <html> after the page's scripts ran, and the document; None without a browser."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        assert not os.environ.get("CI"), "CI must have Chromium: install the package chromium"
        return None
    command = [browser, *FLAGS, *flags, f"--user-data-dir={profile}", "--dump-dom", path.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", timeout=180, check=True)
    start = re.search(r"<html[^>]*>", done.stdout).group()
    return dict(re.findall(r'data-(\w+)="([^"]*)"', start)), done.stdout


def test_plots_are_drawn_under_the_page_s_own_policy(tmp_path):
    path = write_page(tmp_path / "page.html", original=ball_points(500))  # points and meshes
    check_structure(path, "ball.ply")
    result = opened(path, tmp_path / "profile")
    if result is not None:
        attributes, document = result
        assert attributes == {"rendered": "true"}
        assert document.count('class="stage live"') == 3
        assert len(re.findall(r"<canvas", document)) >= 3
        assert 'class="scatterlayer' in document  # the energies


def test_hostile_name_does_nothing_and_views_turn_together(tmp_path):
    path = write_page(tmp_path / "page.html", title=HOSTILE, options={HOSTILE: HOSTILE})
    check_structure(path, HOSTILE)
    text = path.read_text(encoding="utf-8")
    # Without the policy, which alone would stop a hostile script: escaping has to do it.
    text, removed = re.subn(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    assert removed == 1
    text = TURN.join(text.rsplit("</body>", 1))
    path.write_text(text, encoding="utf-8")
    result = opened(path, tmp_path / "profile")
    if result is not None:
        attributes, _ = result
        assert attributes.pop("eyes").split() == ["0.500,1.250,-0.750"] * 3
        assert attributes == {"rendered": "true"}


def test_still_pictures_remain_without_webgl(tmp_path):
    path = write_page(tmp_path / "page.html")
    result = opened(path, tmp_path / "profile", "--disable-3d-apis")
    if result is None:
        check_structure(path, "ball.ply")
    else:
        attributes, document = result
        assert attributes == {"rendered": "pictures"}
        assert "no WebGL" in document
        assert 'class="stage live"' not in document
