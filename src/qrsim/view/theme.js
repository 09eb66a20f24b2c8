// Dark and light, and colours as they are. `m` returns viser's page, null before it is there; `button` has the name of the other theme.
const themeIn = ({ data, state, button, nodes, m }) => {
  const theme = (name, keep = true) => {
    state.theme = name;
    if (keep) try { localStorage.setItem("qrsim-theme", name); } catch { /* a file has no storage */ }
    document.documentElement.classList.toggle("qrsim-dark", name === "dark");
    button.textContent = name === "dark" ? "Light" : "Dark";
    const viewer = m();
    if (!viewer) return;
    viewer.messageQueue.push({
      type: "ThemeConfigurationMessage", titlebar_content: null, control_layout: "floating", control_width: "medium",
      show_logo: false, show_share_button: false, dark_mode: name === "dark", colors: null,
    });
    const tree = nodes();
    for (const [node, updates] of Object.entries(data.themes[name]))
      if (tree[node]) viewer.messageQueue.push({
        type: "SceneNodeUpdateMessage", name: node, owner: tree[node].message.owner, updates,
      });
    viewer.canvas.style.background = data.skies[name];
    viewer.requestRender();
  };
  // Tone mapping would show other colours than those that are told apart.
  const exact = () => m().scene.traverse((object) => {
    for (const material of [object.material].flat())
      if (material?.toneMapped && material.type !== "ShaderMaterial") {
        material.toneMapped = false;
        material.needsUpdate = true;
      }
  });
  return { theme, exact };
};
