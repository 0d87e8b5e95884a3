for (const box of document.querySelectorAll('.player')) {
  const scene = JSON.parse(box.querySelector('script').textContent);
  const canvas = box.querySelector('canvas'), pen = canvas.getContext('2d');
  const button = box.querySelector('button'), slider = box.querySelector('input');
  const speed = box.querySelector('select'), output = box.querySelector('output');
  const section = box.closest('section');
  const plots = [...section.querySelectorAll('.plot[data-begin]')];
  const first = scene.time[0], last = scene.time[scene.time.length - 1];
  let now = first, playing = false, stamp = 0;
  slider.min = first; slider.max = last; slider.step = 0.001;
  for (const plot of plots) {
    plot.cursor = plot.appendChild(document.createElement('div'));
    plot.cursor.className = 'cursor';
    plot.classList.add('seekable');
    plot.addEventListener('click', event => {
      const area = plot.getBoundingClientRect(), d = plot.dataset;
      const share = ((event.clientX - area.left) / area.width - d.left) / (d.right - d.left);
      seek(+d.begin + share * (d.end - d.begin));
    });
  }
  function blend(values, index, share) {
    const a = values[index], b = values[index + 1];
    return a.map((v, k) => Array.isArray(v) ? v.map((w, m) => w + share * (b[k][m] - w))
                                            : v + share * (b[k] - v));
  }
  function frame() {
    let low = 0, high = scene.time.length - 2;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (scene.time[middle] <= now) low = middle; else high = middle - 1;
    }
    const share = (now - scene.time[low]) / (scene.time[low + 1] - scene.time[low]);
    const part = Math.min(Math.max(share, 0), 1);
    return { body1: blend(scene.body1, low, part), body2: blend(scene.body2, low, part),
             tether: blend(scene.tether, low, part), index: low,
             readout: scene.readout[low] + part * (scene.readout[low + 1] - scene.readout[low]),
             wheels: scene.wheels ? blend(scene.wheels, low, part) : [] };
  }
  function colour(tension) {
    const place = Math.min(Math.max(tension / scene.tension_max, 0), 1) * (scene.scale.length - 1);
    const k = Math.min(Math.floor(place), scene.scale.length - 2), part = place - k;
    return 'rgb(' + scene.scale[k].map((v, m) =>
      Math.round(v + part * (scene.scale[k + 1][m] - v))).join(',') + ')';
  }
  function draw() {
    const ratio = window.devicePixelRatio || 1, width = box.clientWidth;
    const height = Math.round(Math.min(Math.max(0.46 * width, 300), 540));
    const pixels = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) {
      [canvas.width, canvas.height] = pixels;
      canvas.style.height = height + 'px';
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = '12px system-ui, sans-serif';
    const at = frame(), middle = Math.round(0.46 * width);
    panel(at, scene.low, scene.high, [52, 34, middle - 10, height - 40]);
    const [x, z] = at.body1, f = scene.follow;
    const near = f ? [[x - f, z - f], [x + f, z + f]] : scene.close_up;
    panel(at, near[0], near[1], [middle + 52, 34, width - 12, height - 40]);
    legend(width < 560);
    output.textContent = scene.run ? now.toFixed(2) + ' s, depth ' + at.readout.toFixed(2) + ' m' :
      (now < 0 ? '−' : '+') + Math.abs(now).toFixed(3) + ' s, rise ' +
      at.readout.toFixed(3) + ' m';
    slider.value = now;
    for (const plot of plots) {
      const d = plot.dataset, share = (now - d.begin) / (d.end - d.begin);
      plot.cursor.style.display = share >= 0 && share <= 1 ? 'block' : 'none';
      plot.cursor.style.left = 100 * (+d.left + share * (d.right - d.left)) + '%';
    }
  }
  function panel(at, low, high, [left, top, right, bottom]) {
    const margin = 16; // so that the fairlead's name at the upper end is whole
    const scale = Math.min((right - left - margin) / (high[0] - low[0]),
                           (bottom - top - margin) / (high[1] - low[1]));
    const originX = (left + right) / 2 - scale * (low[0] + high[0]) / 2;
    const originZ = (top + bottom) / 2 + scale * (low[1] + high[1]) / 2;
    const X = x => originX + scale * x, Z = z => originZ - scale * z;
    const step = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find(v => v * scale >= 56) || 100;
    const label = v => Math.abs(v) < 1e-9 ? '0' : v.toFixed(step < 0.1 ? 2 : step < 1 ? 1 : 0);
    pen.lineWidth = 1; pen.strokeStyle = '#e9ecef'; pen.fillStyle = '#5c636a';
    pen.textAlign = 'center'; pen.textBaseline = 'top';
    for (let k = Math.ceil((left - originX) / scale / step); X(k * step) <= right; k++) {
      line([[X(k * step), top], [X(k * step), bottom]]);
      pen.fillText(label(k * step), X(k * step), bottom + 5);
    }
    pen.textAlign = 'right'; pen.textBaseline = 'middle';
    for (let k = Math.ceil((originZ - bottom) / scale / step); Z(k * step) >= top; k++) {
      line([[left, Z(k * step)], [right, Z(k * step)]]);
      pen.fillText(label(k * step), left - 6, Z(k * step));
    }
    pen.textBaseline = 'top'; pen.fillText('x [m]', right, bottom + 20);
    pen.save();
    pen.translate(left - 44, (top + bottom) / 2); pen.rotate(-Math.PI / 2);
    pen.textAlign = 'center'; pen.fillText('z [m]', 0, 0);
    pen.restore();
    pen.save();
    pen.beginPath(); pen.rect(left, top, right - left, bottom - top); pen.clip();
    pen.strokeStyle = '#8d8272'; pen.lineWidth = 2;
    for (const points of scene.lines) line(points.map(p => [X(p[0]), Z(p[1])]));
    if (!scene.lines.length && !scene.run && !scene.follow) {
      const reach = scene.body1.map(pose => pose[0]);
      const begin = Math.min(...reach) - 0.35, end = Math.max(...reach) + 0.35;
      line([[X(begin), Z(scene.ground)], [X(end), Z(scene.ground)]]);
      pen.lineWidth = 1;
      for (let x = begin; x <= end; x += 10 / scale)
        line([[X(x), Z(scene.ground)], [X(x) - 6, Z(scene.ground) + 7]]);
    }
    pen.strokeStyle = '#868e96'; pen.setLineDash([3, 4]);
    line(scene.body1.slice(0, at.index + 1).concat([at.body1]).map(p => [X(p[0]), Z(p[1])]));
    pen.setLineDash([]);
    pen.lineWidth = 3; pen.lineCap = 'round';
    const third = scene.element / 3;
    for (let k = 0; k + 1 < at.tether.length; k++) {
      const a = at.tether[k], b = at.tether[k + 1];
      pen.strokeStyle = colour((a[4] + b[4]) / 2);
      pen.beginPath();
      pen.moveTo(X(a[0]), Z(a[1]));
      pen.bezierCurveTo(X(a[0] + third * a[2]), Z(a[1] + third * a[3]),
                        X(b[0] - third * b[2]), Z(b[1] - third * b[3]), X(b[0]), Z(b[1]));
      pen.stroke();
    }
    pen.strokeStyle = '#868e96'; pen.lineWidth = 4;
    const tip = scene.follow ? [at.tether[at.tether.length - 1]] : [];
    line([at.body1, at.body2, ...tip].map(p => [X(p[0]), Z(p[1])]));
    body(at.body2, scene.sizes.body2_size, '#d55e00');
    body(at.body1, scene.sizes.body1_size, '#0072b2');
    pen.strokeStyle = '#212529'; pen.lineWidth = 2;
    for (const [u, w, wide, high] of at.wheels) {
      pen.beginPath(); pen.ellipse(X(u), Z(w), scale * wide, scale * high, 0, 0, 2 * Math.PI);
      pen.stroke();
    }
    pen.fillStyle = '#212529';
    const root = at.tether[0];
    pen.fillRect(X(root[0]) - 5, Z(root[1]) - 5, 10, 10);
    pen.textAlign = 'left'; pen.textBaseline = 'middle';
    pen.fillText('fairlead', X(root[0]) + 11, Z(root[1]));
    pen.restore();
    pen.strokeStyle = '#ced4da'; pen.lineWidth = 1;
    pen.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
    function line(points) {
      pen.beginPath();
      points.forEach((p, k) => k ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1]));
      pen.stroke();
    }
    function body(pose, size, fill) {
      pen.save();
      pen.translate(X(pose[0]), Z(pose[1])); pen.rotate(-pose[2]);
      pen.fillStyle = fill; pen.strokeStyle = '#fff'; pen.lineWidth = 1.5;
      const w = scale * (pose.length > 3 ? pose[3] : size[0]), h = scale * size[1];
      pen.fillRect(-w / 2, -h / 2, w, h); pen.strokeRect(-w / 2, -h / 2, w, h);
      pen.restore();
    }
  }
  function legend(small) {
    pen.textBaseline = 'middle'; pen.textAlign = 'left';
    let x = small ? 10 : 52;
    const words = small ? 'tension: 0' : 'tension of the tether: 0';
    for (const [text, fill] of [['Body 1', '#0072b2'], ['Body 2', '#d55e00']]) {
      pen.fillStyle = fill; pen.fillRect(x, 12, 16, 10);
      pen.fillStyle = '#212529'; pen.fillText(text, x + 22, 17); x += 84;
    }
    pen.fillText(words, x, 17);
    x += pen.measureText(words).width + 8;
    for (let k = 0; k < 90; k++) {
      pen.fillStyle = colour(scene.tension_max * k / 89); pen.fillRect(x + k, 12, 1.5, 10);
    }
    pen.fillStyle = '#212529';
    const unit = scene.beyond ? ' N and more' : ' N';
    pen.fillText(scene.tension_max.toPrecision(3) + unit, x + 98, 17);
  }
  function seek(time) { now = Math.min(Math.max(time, first), last); draw(); }
  function tick(time) {
    if (!playing) return;
    if (stamp) now += (time - stamp) / 1000 * speed.value;
    stamp = time;
    if (now >= last) { now = last; pause(); }
    draw();
    if (playing) requestAnimationFrame(tick);
  }
  function pause() { playing = false; button.textContent = 'Play'; }
  function play() {
    if (now >= last) now = first;
    playing = true; stamp = 0; button.textContent = 'Pause'; requestAnimationFrame(tick);
  }
  button.addEventListener('click', () => playing ? pause() : play());
  slider.addEventListener('input', () => { pause(); seek(+slider.value); });
  box.addEventListener('keydown', event => {
    if (event.target === slider || event.target === speed) return;
    if (event.key === 'ArrowRight') { pause(); seek(now + 0.02); }
    if (event.key === 'ArrowLeft') { pause(); seek(now - 0.02); }
  });
  new ResizeObserver(draw).observe(box);
  box.seek = seek;
  seek(+(box.dataset.poster || first));
}
