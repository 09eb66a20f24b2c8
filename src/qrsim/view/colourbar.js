// The colour bar: which quantity colours vehicles and true paths, and its range.
const colourBarIn = (root) => {
  const box = document.createElement("div"), title = document.createElement("b");
  const bar = document.createElement("div"), ends = document.createElement("div");
  box.className = "qrsim-bar";
  box.hidden = true;
  box.append(title, bar, ends);
  root.append(box);
  return (told) => {
    box.hidden = !told;
    if (!told) return;
    title.textContent = told.title;
    bar.style.background = `linear-gradient(90deg,${told.colours.map((colour) => `rgb(${colour.join(",")})`).join(",")})`;
    ends.replaceChildren(...told.ends.map((end) => Object.assign(document.createElement("span"), { textContent: end })));
  };
};
